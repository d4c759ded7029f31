// A lit rock face.
in vec3 v_relative, v_normal, v_local;
in vec4 v_matter;
flat in float v_index;
#include "common.glsl"
layout(location = 1) out float o_depth;
uniform sampler2D u_tile_a;
uniform vec2 u_grain;           // 1 / period, strength of the grain on rock faces
uniform float u_rock_theta;
uniform Hapke u_rock;

void main() {
    vec3 normal = normalize(v_normal);
    vec3 view = -normalize(v_relative);
    vec2 plane = abs(v_local.z) > 0.3 * length(v_local.xy) ? v_local.xy : v_local.xz + 0.37;
    vec2 grain = texture(u_tile_a, (plane + v_index * 0.173) * u_grain.x).xy - 0.501961;
    vec3 side = normalize(cross(normal, vec3(0.37, 0.71, 0.6)));
    normal = normalize(normal + u_grain.y * (grain.x * side + grain.y * cross(normal, side)));
    float mu0 = dot(normal, u_sun), mu = max(dot(normal, view), 0.02);
    float lit = disc(v_matter.x / max(v_matter.y, 1e-3), u_sun_radius);
#ifdef ROVER_SHADOW
    lit *= rover_visibility(v_relative);
#endif
    float reflectance = hapke(mu0, mu, dot(u_sun, view), u_rock_theta, v_matter.z, u_rock);
    o_radiance = u_irradiance * reflectance * lit;
    o_depth = dot(v_relative, u_axis);
}
