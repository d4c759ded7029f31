// Where an image shows what: a pinhole, or with EQUIDISTANT a fisheye (camera/equidistant.py).
uniform vec4 u_pinhole;         // focal lengths and principal point [px]
#ifdef EQUIDISTANT
uniform vec4 u_fisheye;         // k1 to k4
uniform float u_limit;          // angle to the axis where the image ends [rad]

#ifdef DISTORTED_FISHEYE
float radius_at(float a) {
    float t = a * a;
    return a * (1.0 + t * (u_fisheye.x + t * (u_fisheye.y + t * (u_fisheye.z + t * u_fisheye.w))));
}
float slope_at(float a) {
    float t = a * a;
    return 1.0 + t * (3.0 * u_fisheye.x + t * (5.0 * u_fisheye.y
                                               + t * (7.0 * u_fisheye.z + t * 9.0 * u_fisheye.w)));
}
float angle_at(float r) {
    float a = min(r, u_limit);
    for (int i = 0; i < 6; i++)
        a = clamp(a + (r - radius_at(a)) / max(slope_at(a), 0.05), 0.0, u_limit);
    return a;
}
#else
float radius_at(float a) { return a; }
float slope_at(float a) { return 1.0; }
float angle_at(float r) { return min(r, u_limit); }
#endif

// Solid angle of a pixel over that on the axis, at a distance from it over the focal length.
float falloff_at(float r) {
    float a = max(angle_at(r), 1e-3);
    return sin(a) / (radius_at(a) * slope_at(a));
}

bool shows(vec2 p) { return length((p - u_pinhole.zw) / u_pinhole.xy) <= radius_at(u_limit); }

// The unit vector that a pixel shows, and the pixel that shows a vector; what lies outside the
// image repeats its edge.
vec3 ray_of(vec2 p) {
    vec2 q = (p - u_pinhole.zw) / u_pinhole.xy;
    float r = length(q), a = angle_at(r);
    return vec3(r > 1e-6 ? q * (sin(a) / r) : q, cos(a));
}
vec2 place_of(vec3 d) {
    float beside = length(d.xy);
    float a = min(atan(beside, d.z), u_limit - 1.0 / u_pinhole.x);
    float scale = beside > 1e-6 * abs(d.z) ? radius_at(a) / beside : 1.0 / d.z;
    return d.xy * scale * u_pinhole.xy + u_pinhole.zw;
}
#endif
