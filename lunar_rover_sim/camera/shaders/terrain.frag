// Lit regolith: grid-scale slope and shadow, two tiles of finer relief, albedo, bounced light.
in vec3 v_relative;
#include "common.glsl"
uniform sampler2D u_ground;     // slope x, slope y, clearance, occluder distance
uniform sampler2D u_matter;     // albedo / 2, scattered irradiance, lit surroundings
uniform sampler2D u_tile_a, u_tile_b;   // slope x, slope y, horizon tangent, its deviation
uniform vec4 u_tile;            // 1 / period of a and b [1/m], slope scale of a and b
uniform vec4 u_turn;            // cos, sin of the turn of tile b; centre and half range of horizon
uniform vec2 u_grid;            // 1 / (n cell), offset of the first sample in texture units
uniform float u_inner;          // half extent of the finer level inside this one [m]
uniform vec2 u_theta;           // tangent of the roughness that is not drawn: near, far
uniform Hapke u_regolith;

void main() {
    vec2 xy = v_relative.xy + u_camera.xy;
#ifdef OUTER
    if (max(abs(xy.x), abs(xy.y)) < u_inner) discard;
#endif
    vec2 uv = xy * u_grid.x + u_grid.y;
    vec2 dx = dFdx(v_relative.xy), dy = dFdy(v_relative.xy);
    float along = max(dot(dx, dx), dot(dy, dy)), across = min(dot(dx, dx), dot(dy, dy));
    // Less blur along the line of sight than an isotropic footprint would give.
    float squeeze = min(1.0, sqrt(16.0 * across / along));
    dx *= dot(dx, dx) >= along ? squeeze : 1.0;
    dy *= dot(dy, dy) >= along ? squeeze : 1.0;
    vec4 ground = textureGrad(u_ground, uv, dx * u_grid.x, dy * u_grid.x);
    vec4 matter = textureGrad(u_matter, uv, dx * u_grid.x, dy * u_grid.x);
    vec4 a = textureGrad(u_tile_a, xy * u_tile.x, dx * u_tile.x, dy * u_tile.x);
    mat2 turn = mat2(u_turn.x, u_turn.y, -u_turn.y, u_turn.x) ;
    vec4 b = textureGrad(u_tile_b, turn * xy * u_tile.y, turn * dx * u_tile.y,
                         turn * dy * u_tile.y);
    vec2 slope_a = (a.xy - 0.501961) * u_tile.z;
    vec2 slope_b = (b.xy - 0.501961) * u_tile.w * turn;
    vec2 slope = ground.xy + slope_a + slope_b;
    vec3 normal = normalize(vec3(-slope, 1.0));
#ifdef TRUTH
    emit_truth(normalize(vec3(-ground.xy, 1.0)), 1.0);
#else
    vec3 view = -normalize(v_relative);
    float horizontal = length(u_sun.xy) + 1e-6;
    vec2 heading = u_sun.xy / horizontal;
    float tangent = u_sun.z / horizontal - dot(ground.xy, heading);
    float width = u_sun_radius * (1.0 + tangent * tangent);
    float lit = disc(ground.z / ground.w, u_sun_radius);
    float above_a = tangent - (u_turn.z + (2.0 * a.z - 1.0) * u_turn.w);
    float above_b = tangent - dot(slope_a, heading) - (u_turn.z + (2.0 * b.z - 1.0) * u_turn.w);
    float spread_a = 2.0 * a.w * u_turn.w, spread_b = 2.0 * b.w * u_turn.w;
    float lit_a = disc(above_a, width + 1.8 * spread_a);
    float lit_b = disc(above_b, width + 1.8 * spread_b);
    float footprint = sqrt(max(dot(dx, dx), dot(dy, dy)));
    float far = clamp(0.5 + 0.25 * log2(footprint / 0.02), 0.0, 1.0);
    lit *= mix(lit_a * lit_b, 1.0, far);
#ifdef ROVER_SHADOW
    lit *= rover_visibility(v_relative);
#endif
    float albedo = 2.0 * matter.r;
    float mu0 = dot(normal, u_sun), mu = max(dot(normal, view), 0.02);
    float reflectance = hapke(mu0, mu, dot(u_sun, view), mix(u_theta.x, u_theta.y, far), albedo,
                              u_regolith);
    emit(u_irradiance * reflectance * lit, v_relative);
#endif
}
