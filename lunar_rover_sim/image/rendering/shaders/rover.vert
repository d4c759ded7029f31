// The rover: each vertex moves with its link.
in vec3 a_position, a_normal;
in float a_albedo, a_link;
in vec2 a_tint;
in vec3 a_gloss;
uniform mat4 u_links[LINKS];
#include "view.glsl"
out vec3 v_relative, v_normal;
out float v_albedo;
flat out vec2 v_tint;
flat out vec3 v_gloss;
out vec3 v_local;
flat out float v_link;

void main() {
    mat4 link = u_links[int(a_link)];
    v_relative = (link * vec4(a_position, 1.0)).xyz - u_camera;
    v_normal = mat3(link) * a_normal;
    v_albedo = a_albedo;
    v_tint = a_tint;
    v_gloss = a_gloss;
    v_local = a_position;
    v_link = a_link;
    gl_Position = u_clip * vec4(v_relative, 1.0);
}
