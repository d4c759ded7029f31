// A block of tracks: vertices on samples of the overlay, and a rim that hangs below its edges.
in vec2 a_ij;                   // column, row; -1 and u_cells + 1: the rim
in vec3 i_block;                // first sample in x, in y; stride
uniform float u_cells;          // along one side
uniform sampler2D u_soil;       // height change [m], in a window that wraps around (track_map.py)
uniform float u_near_scale;     // 1 / its extent [1/m]
#include "heights.glsl"
#include "view.glsl"
out vec3 v_relative;

void main() {
    vec2 ij = clamp(a_ij, 0.0, u_cells), rim = a_ij - ij;
    vec2 place = i_block.xy + ij * i_block.z;
    vec2 xy = place * PRINT_CELL;
    float z = grid_height(xy)
        + textureLod(u_soil, xy * u_near_scale + PRINT_OFFSET, 0.0).r;
    // Between blocks of different strides, and at the ground around, there are no gaps.
    if (rim != vec2(0.0)) { xy += 0.001 * rim; z -= 0.004; }
    v_relative = vec3(xy, z) - u_camera;
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
