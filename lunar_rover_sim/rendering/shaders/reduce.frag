// Mean radiance of cells of the image, from every second pixel of every second row. The sky is left
// out: stray light of the sun is computed apart, and the Earth has none.
uniform sampler2D u_radiance;   // the left image above the right one
uniform sampler2D u_depth;      // 0: sky
uniform vec4 u_size;            // of one image [px]; 1 / size of both
uniform float u_most;           // brighter light is that of the sun itself, and cut off
uniform float u_rows;           // of cells of one image
layout(location = 0) out float o_mean;

void main() {
    vec2 cell = floor(gl_FragCoord.xy);
    float side = floor(cell.y / u_rows);
    vec2 first = (cell - vec2(0.0, side * u_rows)) * float(CELL) + 0.5;
    float sum = 0.0;
    // Sampled at pixel centres: on llvmpipe texelFetch takes longer.
    for (float y = first.y; y < min(first.y + float(CELL), u_size.y); y += 2.0)
        for (float x = first.x; x < min(first.x + float(CELL), u_size.x); x += 2.0)
        {
            vec2 at = vec2(x, y + side * u_size.y) * u_size.zw;
            float light = min(textureLod(u_radiance, at, 0.0).r, u_most);
            sum += textureLod(u_depth, at, 0.0).r == 0.0 ? 0.0 : light;
        }
    o_mean = sum * (4.0 / float(CELL * CELL));
}
