// Scattered sunlight near the sun, as far as the mesh of stray light leaves it out.
#include "image.glsl"
uniform vec3 u_axis;            // place of the optical axis within the attachments [px]; 1 / focal
uniform vec4 u_sun;             // direction cosines; radiance; 1 / core^2
uniform float u_power;          // of the fall, minus half
uniform vec4 u_near;            // place of the sun within the attachments [px]; inner and outer radius
layout(location = 0) out vec4 o_stray;

void main() {
    vec2 tangent = (gl_FragCoord.xy - u_axis.xy) * u_axis.z;
#ifdef EQUIDISTANT
    vec2 apart = (gl_FragCoord.xy - u_near.xy) * u_axis.z;
    float radiance = u_sun.z / falloff_at(length(tangent));
#else
    vec2 apart = tangent * inversesqrt(1.0 + dot(tangent, tangent)) - u_sun.xy;
    float radiance = u_sun.z;
#endif
    float share = 1.0 - smoothstep(u_near.z, u_near.w, distance(gl_FragCoord.xy, u_near.xy));
    o_stray = vec4(share * radiance * pow(1.0 + dot(apart, apart) * u_sun.w, u_power), 0.0, 0.0, 1.0);
}
