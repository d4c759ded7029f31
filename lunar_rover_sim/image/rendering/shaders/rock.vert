// One rock: an instance of a shape, its columns scaled by its diameter.
in vec3 a_position, a_normal;
in vec3 i_position, i_x, i_y, i_z;
in vec4 i_light;
in vec4 i_matter;               // exitance of the ground around, albedo factor, index, height of the ground [m]
#include "view.glsl"
out vec3 v_relative, v_normal, v_local;
out vec3 v_matter;              // clearance, occluder distance, albedo
flat out float v_around;
flat out float v_index;
flat out float v_diameter;
out float v_height;             // above the ground [m]

void main() {
    mat3 turn = mat3(i_x, i_y, i_z);
    vec3 arm = turn * a_position;
    v_local = a_position * length(i_x);
    v_relative = i_position - u_camera + arm;
    // Solids have axes of different length.
    v_normal = length(a_normal) * normalize(
        i_x * (a_normal.x / dot(i_x, i_x)) + i_y * (a_normal.y / dot(i_y, i_y))
        + i_z * (a_normal.z / dot(i_z, i_z)));
    float up = clamp(0.5 + arm.z / (0.7 * length(i_x)), 0.0, 1.0);
    v_matter = vec3(mix(i_light.xy, i_light.zw, up), i_matter.y);
    v_around = i_matter.x;
    v_index = i_matter.z;
    v_diameter = length(i_x);
    v_height = i_position.z + arm.z - i_matter.w;
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
