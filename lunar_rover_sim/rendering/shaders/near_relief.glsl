// The shape of the ground near the cameras: the grid, tracks, and the relief below both.
uniform sampler2D u_base;       // heights of the finest grid, between which the sampler interpolates
uniform sampler2D u_relief;     // height over u_base [m], bound of the slopes around; wraps around
uniform float u_relief_scale;   // 1 / its extent [1/m]
#include "relief_share.glsl"

// Height of the ground [m], and a bound of the slopes of its relief around.
vec2 near_ground(vec2 xy) {
    float base = textureLod(u_base, (xy * u_lattice.x + u_lattice.y + 0.5) * u_lattice.w, 0.0).r;
    vec2 relief = textureLod(u_relief, xy * u_relief_scale, 0.0).rg * relief_share(xy);
#ifdef TRACKS
    vec2 soil = soil_at(xy);
    base += soil.x;
    relief *= soil.y;
#endif
    return vec2(base + relief.x, relief.y);
}
