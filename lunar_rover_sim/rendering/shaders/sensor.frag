// Radiance to digital numbers: point spread, vignetting, electrons, noise, converter.
uniform sampler2D u_radiance;   // the left image above the right one
uniform vec2 u_rows;            // first and last row of the image within the attachments
uniform vec2 u_texel;           // 1 / size of the pair of images
uniform sampler2D u_pattern;    // fall-off times gain, offset; in units of u_pattern_span
uniform vec2 u_pattern_span;    // gain, twice the largest offset [e-]
uniform float u_spread;         // weight of each direct neighbour; the pixel itself has 1
uniform float u_electrons;      // electrons per radiance on the axis
uniform float u_dark;           // dark signal [e-]
uniform vec2 u_noise;           // shot (0 or 1), read [e-]
uniform float u_well;           // electrons that a pixel holds
uniform vec3 u_adc;             // 1 / full well, black level, largest number
uniform vec2 u_out;             // numbers of the output per number, 1 / largest of the output
uniform uint u_frame;           // a different number for each seed and frame
layout(location = 0) out float o_level;

// The integer part of positive numbers up to 2^23, by their bits; llvmpipe converts slowly.
uvec2 whole(vec2 x) { return floatBitsToUint(floor(x) + 8388608.0) & 0x7FFFFFu; }

uint hash(uint s) {
    s = s * 747796405u + 2891336453u;                   // PCG (Jarzynski & Olano, 2020)
    uint word = ((s >> ((s >> 28u) + 4u)) ^ s) * 277803737u;
    return (word >> 22u) ^ word;
}

float gaussian(uint s) {
    uint a = hash(s), b = a * 2654435769u;
    b = (b ^ (b >> 15u)) * 2246822519u;
    float radius = sqrt(-2.0 * log((float(a >> 8u) + 0.5) / 16777216.0));
    return radius * cos(float(b >> 8u) * (6.28318530718 / 16777216.0));     // Box & Muller
}

#ifdef DISTORTED
// The place in the undistorted image that each pixel shows.
uniform sampler2D u_source;
float radiance_at(vec2 q) {
    ivec2 c = ivec2(floor(q));
    vec2 f = q - vec2(c);
    return mix(mix(texelFetch(u_radiance, c, 0).r, texelFetch(u_radiance, c + ivec2(1, 0), 0).r,
                   f.x),
               mix(texelFetch(u_radiance, c + ivec2(0, 1), 0).r,
                   texelFetch(u_radiance, c + 1, 0).r, f.x), f.y);
}
#endif

#ifdef COLLECTED
uniform sampler2D u_charge;     // electrons of each pixel, after blooming
#endif

#ifdef MOVING
// Paths during the exposure that are hardly longer than a pixel. The variance of light along them,
// a twelfth of their square, adds to that of the point spread; see motion.frag.
uniform sampler2D u_depth;      // see LitTargets
uniform vec4 u_pinhole;         // focal lengths and centre [px]
uniform vec3 u_turn, u_shift;   // of the camera relative to the world during the exposure [rad], [m]

vec2 path_of(vec2 p, vec2 at) {
    float depth = abs(textureLod(u_depth, at, 0.0).r);
    vec3 ray = vec3((p - u_pinhole.zw) / u_pinhole.xy, 1.0);
    vec3 move = cross(u_turn, ray) + (depth > 0.0 ? u_shift / depth : vec3(0.0));
    return (move.xy - ray.xy * move.z) * u_pinhole.xy;
}
#endif

void main() {
    // Sampled at pixel centres: on llvmpipe texelFetch takes longer.
    vec2 at = gl_FragCoord.xy * u_texel;
#ifdef COLLECTED
    float electrons = textureLod(u_charge, at, 0.0).r;
#else
#ifdef DISTORTED
    vec2 q = textureLod(u_source, at, 0.0).rg;
    float value = radiance_at(q);
#ifdef SPREAD
    value = (value + u_spread * (radiance_at(q + vec2(1.0, 0.0)) + radiance_at(q - vec2(1.0, 0.0))
                                 + radiance_at(q + vec2(0.0, 1.0))
                                 + radiance_at(q - vec2(0.0, 1.0)))) / (1.0 + 4.0 * u_spread);
#endif
#else
    float value = textureLod(u_radiance, at, 0.0).r;
#ifdef SPREAD
    // Neighbours above and below must belong to the same image.
    float up = gl_FragCoord.y > u_rows.x + 1.0 ? u_texel.y : 0.0;
    float down = gl_FragCoord.y < u_rows.y ? u_texel.y : 0.0;
    float beside = textureLod(u_radiance, at - vec2(u_texel.x, 0.0), 0.0).r
        + textureLod(u_radiance, at + vec2(u_texel.x, 0.0), 0.0).r;
    float over = textureLod(u_radiance, at - vec2(0.0, up), 0.0).r
        + textureLod(u_radiance, at + vec2(0.0, down), 0.0).r;
    vec2 spread = vec2(u_spread / (1.0 + 4.0 * u_spread));
#ifdef MOVING
    vec2 path = path_of(gl_FragCoord.xy - vec2(0.5, 0.5 + u_rows.x), at);
    spread += min(path * path * (1.0 / 24.0), 0.12);   // what is very near may move farther
#endif
    value = spread.x * beside + spread.y * over + (1.0 - 2.0 * (spread.x + spread.y)) * value;
#endif
#endif
#endif
    vec2 pattern = u_pattern_span * (textureLod(u_pattern, at, 0.0).rg - vec2(0.0, 0.5));
#ifndef COLLECTED
    float electrons = value * u_electrons * pattern.x + u_dark;
#endif
#ifdef CHARGE
    o_level = electrons;
    return;
#endif
#ifdef NOISE
    // Shot and read noise are independent: one Gaussian of their joint variance.
    uvec2 p = whole(gl_FragCoord.xy);
    uint pixel = p.y * uint(textureSize(u_pattern, 0).x) + p.x;
    electrons += sqrt(u_noise.x * max(electrons, 0.0) + u_noise.y * u_noise.y)
        * gaussian(pixel * 2654435761u ^ u_frame);
#endif
    electrons = min(electrons, u_well) + pattern.y;
    float number = (electrons * u_adc.x * (1.0 - u_adc.y) + u_adc.y) * u_adc.z;
    number = clamp(floor(number + 0.5), 0.0, u_adc.z);
#ifdef ROOT
    float signal = max(number - u_adc.y * u_adc.z, 0.0) / ((1.0 - u_adc.y) * u_adc.z);
    o_level = floor(sqrt(signal) / u_out.y + 0.5) * u_out.y;
#else
    o_level = floor(number * u_out.x) * u_out.y;
#endif
}
