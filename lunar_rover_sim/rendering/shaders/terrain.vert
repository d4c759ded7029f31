// A chunk of the height grid: vertices of the grid itself, morphed towards those of the next
// coarser mesh with distance.
in vec2 a_ij;                   // column, row; 256 more of the column: the lower rim of a skirt
in vec4 i_chunk;                // first column, first row, stride (and side), range [m]
uniform sampler2D u_heights;
uniform vec4 u_lattice;         // 1 / cell [1/m], half and last whole index of cells, 1 / samples
uniform float u_cell;
#include "view.glsl"
out vec3 v_relative;

float height(vec2 g) { return textureLod(u_heights, (g + 0.5) * u_lattice.w, 0.0).r; }

void main() {
    float stride = floor(i_chunk.z);
    vec2 ij = a_ij;
#ifdef SKIRT
    bool lower = ij.x > 255.0;
    float along = lower ? ij.x - 256.0 : ij.x, side = 4.0 * fract(i_chunk.z);
    ij = side < 0.5 ? vec2(0.0, along) : side < 1.5 ? vec2(CHUNK, along)
        : side < 2.5 ? vec2(along, 0.0) : vec2(along, CHUNK);
#endif
    vec2 odd = mod(ij, 2.0) * stride;
    vec2 g = min(i_chunk.xy + ij * stride, 2.0 * u_lattice.y);
    float z = height(g);
    vec2 xy = (g - u_lattice.y) * u_cell - u_camera.xy;
    // Both cameras get the same mesh, the one that chunks were chosen for: it has no gaps.
    float far = length(vec3(xy - u_centre, u_above)) / i_chunk.w;
    float share = clamp((far - 0.85) * (1.0 / 0.15), 0.0, 1.0);
    if (share > 0.0) z = mix(z, 0.5 * (height(g - odd) + height(g + odd)), share);
#ifdef SKIRT
    if (lower) z -= 0.25 * u_cell * stride;
#endif
    v_relative = vec3(xy, z - u_camera.z);
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
