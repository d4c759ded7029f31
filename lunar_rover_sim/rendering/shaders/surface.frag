// Depth of the ground itself, from that of its meshes: where the ray of each pixel meets the
// triangles of the grid, and nearby the relief below it.
#include "view.glsl"
#include "ray.glsl"
#include "heights.glsl"
#ifdef TRACKS
#include "tracks.glsl"
#endif
uniform sampler2D u_depth;
layout(location = 0) out float o_depth;

#ifdef REFINE
// Where the mesh is coarser than the grid, find where the ray meets the triangles of the grid.
uniform vec3 u_refine;          // nearest and farthest depth, bound of the mesh's error [m]

float ground_at(vec2 xy) {
#ifdef TRACKS
    return grid_height(xy) + print_height(xy);
#else
    return grid_height(xy);
#endif
}

float refined(float depth, vec3 ray) {
    vec3 origin = u_camera;
    // A loop ends as soon as no pixel of a block needs it.
    int steps = depth > u_refine.x && depth < u_refine.y ? 8 : 0;
    float reach = min(u_refine.z / max(-ray.z, 0.25 * u_refine.z), 0.06 * depth);
    float t = depth - reach, low = t, high = -1.0, f_low = -1.0, f_high = 0.0;
    for (int i = 0; i <= steps && steps > 0; i++) {
        float f = origin.z + ray.z * t - ground_at(origin.xy + ray.xy * t);
        if (f <= 0.0) { high = t; f_high = f; break; }
        low = t;
        f_low = f;
        t += reach * 0.25;
    }
    int turns = high > 0.0 && f_low > 0.0 ? 2 : 0;
    if (turns == 0) return depth;
    for (int i = 0; i < turns; i++) {
        t = low + (high - low) * f_low / max(f_low - f_high, 1e-9);
        float f = origin.z + ray.z * t - ground_at(origin.xy + ray.xy * t);
        if (f > 0.0) { low = t; f_low = f; } else { high = t; f_high = f; }
    }
    return low + (high - low) * f_low / max(f_low - f_high, 1e-9);
}
#endif

#ifdef RELIEF
#include "near_relief.glsl"
uniform vec2 u_relief_most;     // greatest height of the relief [m], and half of the finest grid

// Steps are as long as the slopes around a point allow: Dummer, Cone step mapping, 2006.
float displaced(float depth, vec3 ray) {
    vec3 origin = u_camera;
    vec2 xy = origin.xy + ray.xy * depth;
    bool near = depth > 0.0 && relief_share(xy) > 0.0
        && max(abs(xy.x), abs(xy.y)) < u_relief_most.y;
    float across = length(ray.xy);
    float t = depth - min(u_relief_most.x / max(-ray.z, 0.05 * across), 0.5 * depth);
    float f = 0.0, before = t, f_before = 0.0, descent = 1.0, close = 0.25 * u_pixel * t;
    // All reads are in loops, which end as soon as no pixel of a block needs them.
    int steps = near ? 14 : 0;
    for (int i = 0; i < steps; i++) {
        vec2 ground = near_ground(origin.xy + ray.xy * t);
        f = origin.z + ray.z * t - ground.x;
        // How fast the ray comes down to the ground, which need not be level.
        if (i == 0) descent = max(f / max(depth - t, 1e-6), 0.02 * across);
        if (f < close) break;
        before = t;
        f_before = f;
        t += RELAXED * f / (descent + across * ground.y);
    }
    int turns = near && f < 0.0 && f_before > 0.0 ? 2 : 0;
    float low = before, high = t, f_high = f;
    for (int i = 0; i < turns; i++) {
        t = low + (high - low) * f_before / (f_before - f_high);
        f = origin.z + ray.z * t - near_ground(origin.xy + ray.xy * t).x;
        if (f > 0.0) { low = t; f_before = f; } else { high = t; f_high = f; }
    }
    return near ? t : depth;
}
#endif

void main() {
    float depth = textureLod(u_depth, gl_FragCoord.xy * u_texel, 0.0).r;
    vec3 ray = pixel_ray(pixel());
#ifdef REFINE
    depth = refined(depth, ray);
#endif
#ifdef RELIEF
    depth = displaced(depth, ray);
#endif
    o_depth = depth;
#ifdef RELIEF
    vec4 clip = u_clip * vec4(ray * depth, 1.0);
    gl_FragDepth = depth > 0.0 ? 0.5 + 0.5 * clip.z / clip.w : 1.0;
#endif
}
