// What is true of the ground; relief below the grid counts where it has shape.
#include "truth.glsl"
// Craters of each cell of each level, the youngest first (crater_map.py).
uniform sampler2DArray u_crater_cells;  // first entry of the list, and the one after the last
uniform sampler2D u_crater_list;        // x, y [m], square of the radius [m2], number
uniform vec2 u_crater_texel;            // 1 / size of the list, 1 where craters are drawn

float crater_at(vec2 xy, vec3 cell) {
    vec2 span = textureLod(u_crater_cells, cell, 0.0).rg;
    for (float i = span.x; i < span.y; i++) {
        float row = floor((i + 0.5) / CRATER_ROW);
        vec4 crater = textureLod(u_crater_list, vec2((i - row * CRATER_ROW + 0.5) / CRATER_ROW,
                                                     (row + 0.5) * u_crater_texel.x), 0.0);
        vec2 away = xy - crater.xy;
        if (dot(away, away) < crater.z) return crater.w;
    }
    return 0.0;
}

#ifdef RELIEF
float drawn_relief(vec2 xy) {
    return textureLod(u_relief, xy * u_relief_scale, 0.0).r * relief_share(xy);
}
#endif

// uv: place in u_ground; extent: half of that of its level [m]
void tell_ground(vec2 xy, vec3 uv, float extent) {
    vec2 slope = textureLod(u_ground, uv, 0.0).xy;
    float label = 1.0, crater = 0.0;
#ifdef RELIEF
    vec2 apart = vec2(0.5 * RELIEF_TEXEL, 0.0);
    vec2 rise = vec2(drawn_relief(xy + apart.xy) - drawn_relief(xy - apart.xy),
                     drawn_relief(xy + apart.yx) - drawn_relief(xy - apart.yx)) / RELIEF_TEXEL;
#ifdef TRACKS
    rise *= soil_at(xy).y;
#endif
    slope += rise;
#endif
#ifdef TRACKS
    Print print = print_at(xy, -16.0);
    slope += print.slope;
    label = max(print.pressed, print.loose) > 0.5 ? 3.0 : 1.0;
#endif
    if (u_crater_texel.y > 0.5) crater = crater_at(xy, vec3(0.5 + 0.5 * xy / extent, uv.z));
    tell(label, crater, normalize(vec3(-slope, 1.0)));
}
