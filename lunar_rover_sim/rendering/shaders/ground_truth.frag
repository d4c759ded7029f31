// What is true of the ground, without the relief below the grid.
#include "common.glsl"
#include "truth.glsl"
#include "ray.glsl"
#ifdef TRACKS
#include "tracks.glsl"
#endif
uniform sampler2D u_depth;          // of all that is seen
uniform sampler2DArray u_ground;    // slope x, slope y, clearance, occluder distance
uniform sampler2DArray u_matter;    // its alpha beyond the finest level: share in far rocks' shadows
uniform vec4 u_level[LEVELS];       // as in ground.frag
uniform vec3 u_heading;
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

void main() {
    float depth = textureLod(u_depth, gl_FragCoord.xy * u_texel, 0.0).r;
    // Recent llvmpipe skips branches that no pixel of a block takes, older ones do not: rows that
    // show no ground beyond the finest grid, or no shadow of the rover, are drawn without them.
    if (depth > 0.0) {
        vec3 relative = pixel_ray(pixel()) * depth;
        vec2 xy = relative.xy + u_camera.xy;
        float reach = max(abs(xy.x), abs(xy.y));
        vec4 grid = u_level[0];
        float layer = 0.0;
        for (int k = 1; k < LEVELS; k++) {
            if (reach > u_level[k - 1].w) { grid = u_level[k]; layer = float(k); }
        }
        vec3 uv = vec3(xy * grid.x + grid.y, layer);
        vec4 ground = textureLod(u_ground, uv, 0.0);
        float label = 1.0;
        float lit = disc(ground.z / ground.w, u_sun_radius);
#ifdef FAR
        if (layer > 0.0) lit *= 1.0 - textureLod(u_matter, uv, 0.0).a;
#endif
#ifdef TRACKS
        Print print = print_at(xy, -16.0);
        float untouched = u_heading.z - dot(ground.xy, u_heading.xy);
        lit *= mix(disc(untouched - print.horizon, u_sun_radius * (1.0 + untouched * untouched)),
                   print.seen, print.coarse);
        ground.xy += print.slope;
        label = max(print.pressed, print.loose) > 0.5 ? 3.0 : 1.0;
#endif
        float crater = 0.0, of_rover = 1.0;
        if (u_crater_texel.y > 0.5)
            crater = crater_at(xy, vec3(0.5 + 0.5 * xy / grid.w, layer));
#ifdef ROVER_SHADOW
        if (lit > 0.0) of_rover = rover_visibility(relative);
#endif
        tell(label, crater, normalize(vec3(-ground.xy, 1.0)), lit, of_rover);
    } else {
        o_ids = o_shadow = o_normal = vec4(0.0);
    }
}
