// One rock: an instance of a shape, its columns scaled by its diameter.
in vec3 a_position, a_normal;
in vec3 i_position, i_x, i_y, i_z;
in float i_number;
#include "view.glsl"
out vec3 v_relative, v_normal;
flat out float v_number;

void main() {
    v_relative = i_position - u_camera + mat3(i_x, i_y, i_z) * a_position;
    // Solids have axes of different length.
    v_normal = length(a_normal) * normalize(
        i_x * (a_normal.x / dot(i_x, i_x)) + i_y * (a_normal.y / dot(i_y, i_y))
        + i_z * (a_normal.z / dot(i_z, i_z)));
    v_number = i_number;
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
