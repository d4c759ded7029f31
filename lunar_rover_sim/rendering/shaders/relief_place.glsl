// Relief below the grid: two tiles, laid out in hexagonal cells of random shifts.
uniform sampler2D u_tile_a;     // slope x, slope y, horizon tangent, salience
uniform vec4 u_tile;            // 1 / period of a and b [1/m], 1 / side of cells [1/m], log2 of
                                // texels of b per metre

// Shifts of both tiles in a cell, over their periods.
vec4 placed(ivec2 cell) {
    uint h = uint(cell.x) * 0x9e3779b9u + uint(cell.y) * 0x85ebca6bu;
    h = (h ^ (h >> 16)) * 0x7feb352du;
    h = (h ^ (h >> 15)) * 0x846ca68bu;
    h ^= h >> 16;
    return vec4(uvec4(h, h >> 8, h >> 16, h >> 24) & 0xffu) * (1.0 / 256.0);
}

// Where both tiles are read: places in them of the nearest cell and of the second nearest one.
// Cells are the hexagons of a triangular lattice, as in Heitz and Neyret, High-performance
// by-example noise using a histogram-preserving blending operator, 2018. In place of blending, the
// more salient copy is drawn where two cells meet, so that a pebble and its shadow stay whole.
struct Placed { vec4 first; vec4 second; float lead; };

Placed placed_at(vec2 xy) {
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
    vec4 at = vec4(p * u_tile.x, p * u_tile.y);
    float lead = (w1 - w2) * (1.0 / ZONE);
    vec4 shift = placed(first), next = lead < 1.0 ? placed(second) : shift;
    return Placed(at + shift, at + next, lead);
}
