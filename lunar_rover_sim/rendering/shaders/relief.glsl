// The look of the relief below the grid.
#include "relief_place.glsl"
uniform sampler2D u_tile_b;     // as u_tile_a
uniform vec2 u_horizon;         // centre and half range of horizon tangents
uniform vec4 u_scales[4];       // polynomials in the mip level of tile b: relief_brightness.py
uniform vec4 u_least_scales;    // their least values
uniform sampler3D u_factor;     // roots of the inverse, over 3.97, of a factor on sunlight, for four
                                // heights of the sun
uniform float u_sun_level;      // 1 / tangent of its height over level ground

const float SLOPES = 3.0;       // see SLOPE_SCALE in relief_tiles.py
const float EDGE = 20.0;        // how sharply a copy ends where the next one begins

struct Relief { vec2 slope_a; vec2 slope_b; vec2 horizon; };

vec4 relief_scales(float level) {
    return max(u_scales[0] + level * (u_scales[1] + level * (u_scales[2] + level * u_scales[3])),
               u_least_scales);
}

Relief relief_at(vec2 xy, float level) {
    Placed place = placed_at(xy);
    float level_a = max(level - 2.0, 0.0);
    // The coarse tile chooses for both.
    // There is no branch: on llvmpipe one around a texture costs more than what it may save.
    vec4 a = textureLod(u_tile_a, place.first.xy, level_a);
    vec4 next_a = textureLod(u_tile_a, place.second.xy, level_a);
    float other = clamp(0.5 - EDGE * (place.lead + a.w - next_a.w), 0.0, 1.0);
    a = mix(a, next_a, other);
    vec4 b = textureLod(u_tile_b, other > 0.5 ? place.second.zw : place.first.zw, level);
    vec2 horizon = u_horizon.x + (2.0 * vec2(a.z, b.z) - 1.0) * u_horizon.y;
    return Relief((a.xy - 0.501961) * SLOPES, (b.xy - 0.501961) * SLOPES, horizon);
}

// Law over the mean of drawn ground; nodes as in relief_brightness.py.
float relief_factor(float level, float cosine, float cos_sun, float cos_g, float tangent) {
    cosine = clamp(cosine, 0.0, 1.0);
    float across = max((1.0 - cosine * cosine) * (1.0 - cos_sun * cos_sun), 1e-6);
    float cos_azimuth = clamp((cos_g - cosine * cos_sun) * inversesqrt(across), -1.0, 1.0);
    vec3 nodes = vec3(textureSize(u_factor, 0));
    vec3 at = vec3(sqrt(0.5 - 0.5 * cos_azimuth), sqrt(cosine), level * (1.0 / float(RELIEF_LEVELS - 1)));
    vec4 factor = textureLod(u_factor, (at * (nodes - 1.0) + 0.5) / nodes, 0.0);
    // The four lie 1/4, 1/2, 1 and 4 times as high as over level ground.
    float sun = log2(max(tangent * u_sun_level, 1e-6));
    sun = clamp(sun < 0.0 ? sun : 0.5 * sun, -2.0, 1.0);
    float inverse = dot(factor * factor, max(1.0 - abs(sun - vec4(-2.0, -1.0, 0.0, 1.0)), 0.0));
    return 1.0 / max(3.96881 * inverse, 0.125);
}
