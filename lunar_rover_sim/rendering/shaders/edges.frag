// Anti-aliasing of the outlines of rocks and rover: a pixel beside an outline mixes with the pixel
// across it, by the share that the straight line through the steps of the outline cuts off
// (Reshetov, Morphological antialiasing, 2009). Outlines are those of geometry, not of texture.
uniform sampler2D u_drawn;      // radiance, the left image above the right one; of objects negative
uniform sampler2D u_depth;      // along the optical axis [m]; 0: sky
uniform vec2 u_texel;           // 1 / size of the pair of images
uniform float u_rows;           // of one image
layout(location = 0) out float o_radiance;

const int FARTHEST_STEP = 20;
const float LEAST_JUMP = 0.08;  // of depth between two objects, relative

// Sampled at pixel centres: on llvmpipe texelFetch takes longer, since it checks bounds.
float drawn_at(vec2 p) { return textureLod(u_drawn, p * u_texel, 0.0).r; }
float depth_at(vec2 p) { return textureLod(u_depth, p * u_texel, 0.0).r; }

// Whether neighbouring pixels of one image show different surfaces, one of them an object.
bool apart(vec2 p, vec2 q) {
    if (floor(p.y / u_rows) != floor(q.y / u_rows)) return false;
    bool object = drawn_at(p) < 0.0;
    if (object != (drawn_at(q) < 0.0)) return true;
    if (!object) return false;
    float a = depth_at(p), b = depth_at(q);
    return abs(a - b) > LEAST_JUMP * min(a, b);
}

// Share of pixel p that the surface beyond its edge towards `across` covers.
float share_of_other(vec2 p, vec2 across) {
    vec2 rise = vec2(0.0), run = vec2(0.0);
    for (int side = 0; side < 2; side++) {
        vec2 step = (side == 0 ? -1.0 : 1.0) * abs(across.yx), q = p;
        for (int k = 0; k < FARTHEST_STEP; k++) {
            bool ends = apart(q, q + step);
            if (ends || !apart(q + step, q + step + across)) {
                rise[side] = ends ? -1.0 : apart(q + across, q + across + step) ? 1.0 : 0.0;
                break;
            }
            q += step;
            run[side]++;
        }
    }
    float t = (2.0 * run.x + 1.0) / (run.x + run.y + 1.0) - 1.0;    // -1 to 1
    return 0.5 * max(-rise.x * max(-t, 0.0) - rise.y * max(t, 0.0), 0.0);
}

void main() {
    vec2 p = gl_FragCoord.xy;
#if defined(COPY)
    o_radiance = abs(drawn_at(p));
#elif defined(FIND)
    if (!apart(p, p + vec2(1.0, 0.0)) && !apart(p, p - vec2(1.0, 0.0))
        && !apart(p, p + vec2(0.0, 1.0)) && !apart(p, p - vec2(0.0, 1.0))) discard;
#else
    float rest = 1.0, mixed = 0.0;
    for (int k = 0; k < 4; k++) {
        float sign = (k & 1) == 0 ? 1.0 : -1.0;
        vec2 across = k < 2 ? vec2(sign, 0.0) : vec2(0.0, sign);
        if (apart(p, p + across)) {
            float share = min(share_of_other(p, across), rest);
            rest -= share;
            mixed += share * abs(drawn_at(p + across));
        }
    }
    o_radiance = rest * abs(drawn_at(p)) + mixed;
#endif
}
