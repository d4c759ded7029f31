// The rover: each vertex moves with its link.
in vec3 a_position, a_normal;
in vec2 a_part;                 // number of the part, and of its link
uniform mat4 u_links[LINKS];
#include "view.glsl"
out vec3 v_relative, v_normal;
flat out float v_number;

void main() {
    mat4 link = u_links[int(a_part.y)];
    v_relative = (link * vec4(a_position, 1.0)).xyz - u_camera;
    v_normal = mat3(link) * a_normal;
    v_number = -1.0 - a_part.x;
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
