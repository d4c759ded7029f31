// Mean radiance of the TIMES x TIMES samples of a pixel.
uniform sampler2D u_samples;
uniform vec2 u_texel;           // 1 / size of the samples
layout(location = 0) out float o_radiance;

void main() {
    vec2 first = floor(gl_FragCoord.xy) * float(TIMES) + 0.5;
    float sum = 0.0;
    // Sampled at their centres: on llvmpipe texelFetch takes longer, since it checks bounds.
    for (int y = 0; y < TIMES; y++)
        for (int x = 0; x < TIMES; x++)
            sum += textureLod(u_samples, (first + vec2(x, y)) * u_texel, 0.0).r;
    o_radiance = sum * (1.0 / float(TIMES * TIMES));
}
