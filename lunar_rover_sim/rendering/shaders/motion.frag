// Mean radiance over the exposure: each pixel gathers along the path on which its point crosses
// the image while the camera turns and moves at constant velocity.
#include "image.glsl"
uniform sampler2D u_radiance;   // at the stamp; sampled linearly
uniform sampler2D u_depth;      // see LitTargets; of a fisheye, distance
uniform vec2 u_rows;            // first row of the image within the attachments, its last row
uniform vec2 u_texel;           // 1 / size of the attachments
uniform float u_exposure;       // [s]
uniform int u_samples;          // over the exposure
// Motion of the camera relative to each body, in its axes: the world, then links that move in view.
uniform vec3 u_rate[BODIES];    // [rad/s]
uniform vec3 u_velocity[BODIES];    // [m/s]
layout(location = 0) out float o_radiance;

// The image above or below is another one.
vec2 texture_at(vec2 q) {
    return (vec2(q.x, clamp(q.y, 0.0, u_rows.y)) + vec2(0.5, 0.5 + u_rows.x)) * u_texel;
}
float radiance_at(vec2 q) { return textureLod(u_radiance, texture_at(q), 0.0).r; }
float inverse_depth(vec2 q) {
    float depth = abs(textureLod(u_depth, texture_at(floor(q + 0.5)), 0.0).r);
    return depth > 0.0 ? 1.0 / depth : 0.0;
}

// The pixel that shows at the stamp what the ray shows at time t: Rodrigues' rotation, its sine
// and cosine as series (error below 1e-6 for turns up to 0.5 rad), then the shift by depth.
vec2 source_at(int body, vec3 ray, float t, float nearness) {
    vec3 rate = u_rate[body], v = u_velocity[body], swing = cross(rate, ray);
    float x = dot(rate, rate) * t * t;
    vec3 g = ray + t * (1.0 - x * (1.0 / 6.0 - x * (1.0 / 120.0))) * swing
        + t * t * (0.5 - x * (1.0 / 24.0 - x * (1.0 / 720.0))) * cross(rate, swing);
    vec3 shift = t * v + 0.5 * t * t * cross(rate, v);
#ifdef EQUIDISTANT
    return place_of(g + shift * nearness);
#else
    vec2 q = g.xy / g.z * (1.0 - shift.z * nearness) + shift.xy * nearness;
    return q * u_pinhole.xy + u_pinhole.zw;
#endif
}

#ifdef ROLLING
// The middle of a row's exposure, after that of the middle row.
uniform float u_line_time;      // [s]
#ifdef DISTORTED
uniform float u_distortion[5];
#endif
float row_time(vec3 ray) {
#ifdef EQUIDISTANT
    return (place_of(ray).y - u_pinhole.w) * u_line_time;
#else
    float y = ray.y;
#ifdef DISTORTED
    float r = dot(ray.xy, ray.xy);
    y = y * (1.0 + r * (u_distortion[0] + r * (u_distortion[1] + r * u_distortion[4])))
        + u_distortion[2] * (r + 2.0 * ray.y * ray.y) + 2.0 * u_distortion[3] * ray.x * ray.y;
#endif
    return y * u_pinhole.y * u_line_time;
#endif
}
#endif

#ifdef ROVER
// What a pixel shows: 0 no part of the rover, else 1 + its link; the first is the body.
uniform sampler2D u_link;       // sampled linearly
uniform float u_leg[BODIES];    // as u_link has it
uniform float u_leg_nearness[BODIES];   // roughly [1/m]
float link_at(vec2 q) { return textureLod(u_link, texture_at(floor(q + 0.5)), 0.0).r; }

// Radiance at q of a part that shows there; parts that move differently do not mix.
float radiance_of(float link, vec2 q) {
    bool mixed = textureLod(u_link, texture_at(q), 0.0).r != link;
    return radiance_at(mixed ? floor(q + 0.5) : q);
}

// Radiance at time t and 1, or 0 and 0 if it is not known: the stamp's picture does not show what
// lies behind the rover.
vec2 seen_at(vec3 ray, vec2 p, float t, float nearness) {
    float own = link_at(p);
#ifdef ON_BODY
    if (own == 1.0) return vec2(radiance_at(p), 1.0);       // the body moves with the camera
#endif
    for (int k = 1; k < BODIES; k++) {
        vec2 q = source_at(k, ray, t, u_leg_nearness[k]);
        if (link_at(q) == u_leg[k]) q = source_at(k, ray, t, inverse_depth(q));
        if (link_at(q) == u_leg[k]) return vec2(radiance_of(u_leg[k], q), 1.0);
    }
    if (own > 0.0) nearness = inverse_depth(source_at(0, ray, t, 0.0));
    vec2 q = source_at(0, ray, t, nearness);
    return link_at(q) == 0.0 ? vec2(radiance_of(0.0, q), 1.0) : vec2(0.0);
}
#endif

void main() {
    vec2 p = gl_FragCoord.xy - vec2(0.5, 0.5 + u_rows.x);
#ifdef EQUIDISTANT
    if (!shows(p)) {
        o_radiance = 0.0;
        return;
    }
    vec3 ray = ray_of(p);
#else
    vec3 ray = vec3((p - u_pinhole.zw) / u_pinhole.xy, 1.0);
#endif
    float nearness = inverse_depth(p);
#ifdef SHORT
    // Paths of up to two pixels: the mean of two samples is that of the linearly interpolated
    // image. Their curvature is far below what can be seen.
    vec3 speed = cross(u_rate[0], ray) + u_velocity[0] * nearness;
    vec2 quarter = 0.25 * u_exposure * (speed.xy - ray.xy * speed.z) * u_pinhole.xy;
    o_radiance = 0.5 * (radiance_at(p - quarter) + radiance_at(p + quarter));
#else
    float middle = 0.0;
#ifdef ROLLING
    middle = row_time(ray);
    for (int i = 0; i < 2; i++) nearness = inverse_depth(source_at(0, ray, middle, nearness));
#endif
    // Samples lie at the middle of equal parts of the exposure.
    float first = 0.5 / float(u_samples) - 0.5, step = 1.0 / float(u_samples);
#ifdef ROVER
    vec2 sum = vec2(0.0);
    for (int i = 0; i < u_samples; i++)
        sum += seen_at(ray, p, middle + (first + float(i) * step) * u_exposure, nearness);
    o_radiance = sum.y > 0.0 ? sum.x / sum.y : radiance_at(p);
#else
    // The path, by a parabola through its start, middle and end.
    vec2 start = source_at(0, ray, middle - 0.5 * u_exposure, nearness);
    vec2 centre = source_at(0, ray, middle, nearness);
    vec2 end = source_at(0, ray, middle + 0.5 * u_exposure, nearness);
    vec2 along = end - start, bend = 2.0 * (start + end - 2.0 * centre);
    float sum = 0.0;
    for (int i = 0; i < u_samples; i++) {
        float s = first + float(i) * step;
        sum += radiance_at(centre + s * (along + s * bend));
    }
    o_radiance = sum * step;
#endif
#endif
}
