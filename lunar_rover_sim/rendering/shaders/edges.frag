// Anti-aliasing of the outlines of ground, rocks and rover: a pixel beside an outline mixes with the
// pixel across it, by the share that the straight line through the steps of the outline cuts off
// (Reshetov, Morphological antialiasing, 2009). Outlines are those of geometry, not of texture.
#include "view.glsl"
uniform sampler2D u_drawn;      // radiance, the left image above the right one
uniform sampler2D u_depth;      // see LitTargets
layout(location = 0) out float o_radiance;

const int FARTHEST_STEP = 24;
const float STEEPEST = 3.5;     // the inverse depth of level ground falls by u_pixel / u_above a row

// Sampled at pixel centres: on llvmpipe texelFetch takes longer, since it checks bounds.
float drawn_at(vec2 p) { return textureLod(u_drawn, p * u_texel, 0.0).r; }
float depth_at(vec2 p) { return textureLod(u_depth, p * u_texel, 0.0).r; }

// Whether neighbouring pixels show different surfaces: their inverse depths differ by more than
// those of ground do, or one is the sky, or one of them an object, whose depth is negative.
float limit() { return STEEPEST * u_pixel / max(u_above, 0.1); }
bool apart(float a, float b) { return abs(a - b) > limit() * a * b; }

bool inside(vec2 p) { return p.y > u_first_row && p.y < u_last_row + 1.0; }

// What the other surface cuts off the pixel `before` and `after` pixels from the ends of a straight
// part of an outline, by the half of its line towards the first end: it starts half a pixel deep
// and leaves in the middle of the part.
float cut(float before, float after) {
    float length = before + after + 1.0;
    float a = min(before, 0.5 * length), b = min(before + 1.0, 0.5 * length);
    return 0.5 * (b - a) * (1.0 - (a + b) / length);
}

// Share of pixel p that the surface beyond its edge towards `across` covers.
float share_of_other(vec2 p, vec2 across, float own, float other) {
    vec2 falls = vec2(0.0), run = vec2(0.0);
    for (int side = 0; side < 2; side++) {
        vec2 step = (side == 0 ? -1.0 : 1.0) * abs(across.yx), q = p;
        float a = own, b = other;
        for (int k = 0; k < FARTHEST_STEP; k++) {
            q += step;
            float next = depth_at(q), beyond = depth_at(q + across);
            bool ends = apart(a, next);
            if (ends || !apart(next, beyond)) {
                falls[side] = ends && !apart(b, beyond) ? 1.0 : 0.0;
                break;
            }
            a = next;
            b = beyond;
            run[side]++;
        }
    }
    return falls.x * cut(run.x, run.y) + falls.y * cut(run.y, run.x);
}

void main() {
    vec2 p = gl_FragCoord.xy;
#if defined(COPY)
    o_radiance = drawn_at(p);
#else
    float own = depth_at(p);
    vec2 x = vec2(1.0, 0.0), y = vec2(0.0, 1.0);
    float west = depth_at(p - x), east = depth_at(p + x);
    float north = depth_at(p - y), south = depth_at(p + y);
#ifdef FIND
    if (!(apart(own, west) || apart(own, east) || apart(own, north) || apart(own, south))) discard;
#else
    if (!inside(p - y)) north = own;
    if (!inside(p + y)) south = own;
    // The outline runs along the rows or along the columns; most of what lies around tells.
    vec4 corners = vec4(apart(own, depth_at(p - x - y)), apart(own, depth_at(p + x - y)),
                        apart(own, depth_at(p - x + y)), apart(own, depth_at(p + x + y)));
    float w = float(apart(own, west)), e = float(apart(own, east));
    float n = float(apart(own, north)), s = float(apart(own, south));
    float gx = 2.0 * (e - w) + corners.y + corners.w - corners.x - corners.z;
    float gy = 2.0 * (s - n) + corners.z + corners.w - corners.x - corners.y;
    bool upright = n + s == 0.0 || (w + e > 0.0 && abs(gx) > abs(gy));
    vec2 across = upright ? (e > w || (e == w && gx > 0.0) ? x : -x)
        : (s > n || (s == n && gy > 0.0) ? y : -y);
    float other = upright ? (across.x > 0.0 ? east : west) : (across.y > 0.0 ? south : north);
    float share = share_of_other(p, across, own, other);
    o_radiance = mix(drawn_at(p), drawn_at(p + across), share);
#endif
#endif
}
