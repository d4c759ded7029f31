// A chunk of the height grid: vertices of the grid itself, morphed towards those of the next
// coarser mesh with distance.
in ivec2 a_ij;
in vec4 i_chunk;                // first column, first row, stride (and side), range [m]
uniform sampler2D u_heights;
uniform int u_last;             // n - 1
uniform float u_cell;
uniform vec3 u_camera;
uniform float u_above;          // height of the camera above the ground [m]
uniform mat4 u_clip;
out vec3 v_relative;

float height(ivec2 g) { return texelFetch(u_heights, clamp(g, ivec2(0), ivec2(u_last)), 0).r; }

void main() {
    int stride = int(i_chunk.z);
    ivec2 ij = a_ij & 255;
#ifdef SKIRT
    int side = int(4.0 * fract(i_chunk.z) + 0.5);
    ij = side == 0 ? ivec2(0, ij.x) : side == 1 ? ivec2(16, ij.x)
        : side == 2 ? ivec2(ij.x, 0) : ivec2(ij.x, 16);
#endif
    ivec2 odd = (ij & 1) * stride;
    ivec2 g = min(ivec2(i_chunk.xy) + ij * stride, ivec2(u_last));
    float fine = height(g);
    float coarse = 0.5 * (height(g - odd) + height(g + odd));
    vec2 xy = (vec2(g) - 0.5 * float(u_last)) * u_cell - u_camera.xy;
    float far = length(vec3(xy, u_above)) / i_chunk.w;
    float z = mix(fine, coarse, clamp((far - 0.85) / 0.15, 0.0, 1.0));
    if (a_ij.x > 255) z -= 0.25 * u_cell * float(stride);   // the lower rim of a skirt
    v_relative = vec3(xy, z - u_camera.z);
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
