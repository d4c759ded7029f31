// The rover: all its parts reflect by Lambert's law.
in vec3 v_relative, v_normal;
in float v_albedo;
flat in vec2 v_tint;     // logarithms of red and blue over green
flat in float v_link;
#include "common.glsl"
#ifdef TRUTH
#include "truth.glsl"
#endif
layout(location = 1) out float o_depth;
uniform vec4 u_body_light;      // clearance and occluder distance at the foot and at the top
uniform vec2 u_body_span;       // world height of foot and top [m]
uniform float u_ground_light;   // exitance of the lit ground around the rover [W/m2]

void main() {
    vec3 normal = normalize(v_normal);
    float up = clamp((v_relative.z + u_camera.z - u_body_span.x) / max(u_body_span.y - u_body_span.x, 1e-3),
                     0.0, 1.0);
    vec2 light = mix(u_body_light.xy, u_body_light.zw, up);
    float lit = disc(light.x / max(light.y, 1e-3), u_sun_radius);
    float mu0 = dot(normal, u_sun);
    float sunlight = u_irradiance * lit * max(mu0, 0.0), of_lamp = 0.0;
    float of_ground = u_ground_light * 0.5 * (1.0 - normal.z);
#ifdef LAMP
    // The rover casts no shadow in this light.
    vec3 to_lamp;
    float lamp = lamp_irradiance(v_relative, normal, to_lamp);
    of_lamp = lamp * max(dot(normal, to_lamp), 0.0);
#endif
    float irradiance = sunlight + of_ground + of_lamp;
    o_radiance = 0.318309886 * v_albedo * irradiance;
    float whole = max(irradiance, 1e-9);
    o_tint = 0.25 * exp(v_tint + u_soil_tint.xy * (of_ground / whole)
                        + u_lamp_tint * (of_lamp / whole));
    o_depth = -dot(v_relative, u_axis);
#ifdef TRUTH
    tell(v_link < 0.5 ? 2.0 : 3.0 + v_link, 0.0, normal);
    tell_light(lit, 1.0, mu0);      // its own shadow on itself is in no picture
#endif
}
