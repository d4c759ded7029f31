// Tracks in soft ground, in two windows around the cameras that wrap around (track_map.py).
uniform sampler2D u_prints;     // near: slope x, slope y, tangent of the horizon, share of the sun
uniform sampler2D u_soil;       // near: height change [m], share that is compacted
uniform sampler2D u_far_prints; // far: sunlight over that on level ground, compacted, loose
uniform sampler2D u_touched;    // 1 where a tile has anything to show
uniform vec4 u_windows;         // 1 / extent [1/m] and half extent [m] of the near window, the far one
uniform vec2 u_window_centre;   // [m]
uniform vec4 u_trodden;         // albedo lost where compacted, where loose; tangent of the roughness
                                // where compacted; what is added to c there

struct Print { vec2 slope; float horizon; float seen; float coarse; float pressed; float loose; };

vec2 print_place(vec2 xy) { return xy * u_windows.x + PRINT_OFFSET; }
bool is_near(vec2 xy) {
    vec2 away = abs(xy - u_window_centre);
    return max(away.x, away.y) < u_windows.y;
}
float print_height(vec2 xy) {
    bool touched = textureLod(u_touched, xy * u_windows.z, 0.0).r > 0.5;
    return touched && is_near(xy) ? textureLod(u_soil, print_place(xy), 0.0).r : 0.0;
}

// Height change [m] of a place, and the share of the relief below the grid that is left there.
vec2 soil_at(vec2 xy) {
    bool touched = textureLod(u_touched, xy * u_windows.z, 0.0).r > 0.5;
    if (!touched || !is_near(xy)) return vec2(0.0, 1.0);
    vec2 s = textureLod(u_soil, print_place(xy), 0.0).rg;
    return vec2(s.x, 1.0 - max(s.y, 0.6 * clamp(abs(s.x) * 1000.0, 0.0, 1.0) * (1.0 - s.y)));
}

// footprint: log2 of its size [m]
Print print_at(vec2 xy, float footprint) {
    if (textureLod(u_touched, xy * u_windows.z, 0.0).r < 0.5)
        return Print(vec2(0.0), -0.1, 1.0, 0.0, 0.0, 0.0);
    if (is_near(xy)) {
        float level = clamp(footprint + PRINT_LOG2, 0.0, 3.0);
        vec4 p = textureLod(u_prints, print_place(xy), level);
        vec2 s = textureLod(u_soil, print_place(xy), level).rg;
        return Print(p.xy, p.z, p.w, min(level, 1.0), s.y,
                     clamp(abs(s.x) * 1000.0, 0.0, 1.0) * (1.0 - s.y));
    }
    vec2 away = abs(xy - u_window_centre);
    if (max(away.x, away.y) > u_windows.w) return Print(vec2(0.0), 0.0, 1.0, 1.0, 0.0, 0.0);
    vec3 p = textureLod(u_far_prints, xy * u_windows.z + FAR_OFFSET, 0.0).rgb;
    return Print(vec2(0.0), 0.0, p.x, 1.0, p.y, p.z);
}
