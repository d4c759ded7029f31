// Relief below the grid: two tiles, laid out in hexagonal cells of random shifts.
uniform sampler2D u_tile_a, u_tile_b;  // slope x, slope y, horizon tangent, salience
uniform vec4 u_tile;            // 1 / period of a and b [1/m], 1 / side of cells [1/m], log2 of
                                // texels of b per metre
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

// Shifts of both tiles in a cell, over their periods.
vec4 placed(ivec2 cell) {
    uint h = uint(cell.x) * 0x9e3779b9u + uint(cell.y) * 0x85ebca6bu;
    h = (h ^ (h >> 16)) * 0x7feb352du;
    h = (h ^ (h >> 15)) * 0x846ca68bu;
    h ^= h >> 16;
    return vec4(uvec4(h, h >> 8, h >> 16, h >> 24) & 0xffu) * (1.0 / 256.0);
}

// Cells are the hexagons of a triangular lattice, as in Heitz and Neyret, High-performance
// by-example noise using a histogram-preserving blending operator, 2018. In place of blending, the
// more salient copy is drawn where two cells meet, so that a pebble and its shadow stay whole.
Relief relief_at(vec2 xy, float level) {
    // A bent lattice and bent relief: no homography maps one copy to another.
    vec2 wave = fract(0.93 * xy.yx) - 0.5;
    vec2 p = xy + 0.2 * wave * (1.0 - 2.0 * abs(wave));
    vec2 q = p * u_tile.z;
    q = vec2(q.x - 0.57735027 * q.y, 1.15470054 * q.y);
    vec2 corner = floor(q), f = q - corner;
    bool upper = f.x + f.y > 1.0;
    vec3 w = upper ? vec3(f.x + f.y - 1.0, 1.0 - f.y, 1.0 - f.x)
        : vec3(1.0 - f.x - f.y, f.x, f.y);
    ivec2 c = ivec2(corner);
    // Vertices: the corner (or its opposite), the one to the right, the one above.
    ivec2 v0 = upper ? c + 1 : c, v1 = c + ivec2(1, 0), v2 = c + ivec2(0, 1);
    // First and second nearest.
    ivec2 first = v0, second = v1;
    float w1 = w.x, w2 = w.y;
    if (w2 > w1) { first = v1; second = v0; w1 = w.y; w2 = w.x; }
    if (w.z > w1) { second = first; w2 = w1; first = v2; w1 = w.z; }
    else if (w.z > w2) { second = v2; w2 = w.z; }
    vec2 at_a = p * u_tile.x, at_b = p * u_tile.y;
    float level_a = max(level - 2.0, 0.0);
    // The coarse tile chooses for both.
    // There is no branch: on llvmpipe one around a texture costs more than what it may save.
    float lead = (w1 - w2) * (1.0 / ZONE);
    vec4 shift = placed(first), next = lead < 1.0 ? placed(second) : shift;
    vec4 a = textureLod(u_tile_a, at_a + shift.xy, level_a);
    vec4 next_a = textureLod(u_tile_a, at_a + next.xy, level_a);
    float other = clamp(0.5 - EDGE * (lead + a.w - next_a.w), 0.0, 1.0);
    a = mix(a, next_a, other);
    vec4 b = textureLod(u_tile_b, at_b + (other > 0.5 ? next.zw : shift.zw), level);
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
