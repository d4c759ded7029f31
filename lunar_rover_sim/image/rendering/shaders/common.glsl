// Shared by ground, rocks and rover. Vectors are in world axes, positions relative to the camera.
#include "hapke.glsl"
#include "view.glsl"

uniform vec3 u_sun;             // unit vector to the sun
uniform float u_irradiance;     // of the sun, normal [W/m2]
uniform float u_sun_radius;     // angular radius of the disc [rad]

// Share of the disc above a straight horizon that lies `angle` below its centre; error < 0.01.
float disc(float angle, float radius) {
    float x = clamp(angle / radius, -1.0, 1.0);
    return 0.5 + x * (0.6366 - 0.1366 * x * x);
}

// Half width of the edge of a shadow that is cast from a distance, as an angle: the disc's radius
// and half a pixel, since a pixel shows the mean of its light.
float softened(vec3 relative, float distance) {
    return u_sun_radius + 0.5 * u_pixel * dot(relative, u_axis) / distance;
}

layout(location = 0) out float o_radiance;
#include "tint.glsl"

#ifdef ROVER_SHADOW
// The rover's silhouette as the sun sees it: signed distance [m] and depth along the sun ray.
uniform sampler2D u_rover_map;
uniform vec3 u_rover_right, u_rover_up;  // axes of the map, over its half extent
uniform vec3 u_rover_centre;             // world position [m]
float rover_visibility(vec3 relative) {
    vec3 d = relative + (u_camera - u_rover_centre);
    vec2 q = vec2(dot(d, u_rover_right), dot(d, u_rover_up));
    if (max(abs(q.x), abs(q.y)) > 1.0) return 1.0;
    vec2 s = textureLod(u_rover_map, 0.5 + 0.5 * q, 0.0).rg;
    float distance = s.y - dot(d, u_sun);
    distance = max(distance, 1e-3);
    return s.y < dot(d, u_sun) ? 1.0 : disc(s.x / distance, softened(relative, distance));
}
#endif

#ifdef LAMP
#include "lamp.glsl"
#endif
