uniform float u_relief_reach;   // distance up to which relief below the grid has shape [m]

// Share of that relief which is shape: all nearby, less and less farther away.
float relief_share(vec2 xy) {
    float away = length(xy - u_camera.xy - u_centre);
    return clamp(5.0 - 5.0 * away / max(u_relief_reach, 1e-6), 0.0, 1.0);
}
