// A lit rock face.
in vec3 v_relative, v_normal, v_local;
in vec3 v_matter;
flat in float v_around;
flat in float v_index;
flat in float v_diameter;
in float v_height;              // above the ground [m]
#include "common.glsl"
#ifdef TRUTH
#include "truth.glsl"
#endif
layout(location = 1) out float o_depth;
uniform sampler2D u_tile_a;
uniform vec4 u_grain;           // 1 / period and strength of grain; periods and strength of lumps
uniform vec2 u_diffuse;         // diffuse albedo / pi of ground and rocks
uniform float u_rock_theta;
uniform Hapke u_rock, u_regolith;
uniform float u_rough;          // how rough rocks are, and how much soil lies on them; 1 is usual

const float CELLS = 5.5;        // facets along the diameter of a rock
const float FACET = 0.75;       // usual tilt of a facet against the face that it lies on
const float FACETS_PX = 12.0;   // rocks that look smaller have none

vec3 random_in(vec3 cell) {
    uvec3 c = uvec3(ivec3(cell)) * uvec3(0x9e3779b9u, 0x85ebca6bu, 0xc2b2ae35u);
    uint h = c.x ^ c.y ^ c.z;
    h = (h ^ (h >> 15)) * 0x846ca68bu;
    h ^= h >> 16;
    return vec3(uvec3(h, h >> 10, h >> 20) & 0x3ffu) * (1.0 / 1023.0) - 0.5;
}

// Tilt of the facet at a place: the same within each of the cells around random points (Worley, A
// cellular texture basis function, 1996), of which the eight nearest candidates are looked at.
vec3 facet(vec3 at) {
    vec3 corner = floor(at - 0.5), tilt = vec3(0.0);
    float nearest = 1e9;
    for (int k = 0; k < 8; k++) {
        vec3 cell = corner + vec3(k & 1, (k >> 1) & 1, k >> 2);
        vec3 random = random_in(cell);
        vec3 apart = cell + 0.5 + 0.9 * random - at;
        float square = dot(apart, apart);
        if (square < nearest) { nearest = square; tilt = random.zxy; }
    }
    return tilt;
}

void main() {
    vec3 normal = normalize(v_normal);
    vec3 view = -normalize(v_relative);
    // Lumps and pits scale with the rock; grain is as fine as that of the ground.
    vec3 facing = abs(v_local);
    vec2 plane = facing.z > max(facing.x, facing.y) ? v_local.xy
        : (facing.x > facing.y ? v_local.yz : v_local.xz + 0.37);
    // The level follows from the distance: derivatives are wrong where `plane` changes.
    float texels = log2(dot(v_relative, u_axis) * u_pixel * float(textureSize(u_tile_a, 0).x));
    vec2 scale = vec2(u_grain.z / v_diameter, u_grain.x);
    vec2 level = max(texels + log2(scale) + 0.5, 0.0);
    vec2 lumps = textureLod(u_tile_a, plane * scale.x + v_index * 0.6180339, level.x).xy;
    vec2 grain = textureLod(u_tile_a, plane * scale.y + v_index * 0.381966, level.y).xy;
    vec2 tilt = u_grain.w * (lumps - 0.501961) + u_grain.y * (grain - 0.501961);
    // Rocks are broken: faces have facets of their own. Soil lies banked up at the foot, and thinly
    // on what faces up.
    float seen = v_diameter / (dot(v_relative, u_axis) * u_pixel * FACETS_PX) - 1.0;
    vec3 own = 17.0 * fract(v_index * vec3(0.618034, 0.754878, 0.569840));
    vec3 rough = u_rough * FACET * clamp(seen, 0.0, 1.0)
        * facet(CELLS * v_local / v_diameter + own);
    float bank = v_diameter * (0.1 + 0.25 * (lumps.x - 0.35));
    float soil = 1.0 - smoothstep(0.4 * bank, bank, v_height);
    soil = max(soil, 0.5 * smoothstep(0.7, 0.95, normal.z + 0.6 * (lumps.y - 0.5)));
    soil *= min(u_rough, 1.0);
    normal = normalize(normal + (1.0 - soil) * rough);
    normal = normalize(mix(normal, vec3(0.5 * normal.xy, 0.87), soil));
    vec3 side = normalize(cross(normal, vec3(0.37, 0.71, 0.6)));
    normal = normalize(normal + tilt.x * side + tilt.y * cross(normal, side));
    Hapke matter = Hapke(mix(u_rock.w, u_regolith.w, soil), mix(u_rock.b, u_regolith.b, soil),
                         mix(u_rock.c, u_regolith.c, soil), mix(u_rock.b_s0, u_regolith.b_s0, soil),
                         mix(u_rock.h_s, u_regolith.h_s, soil));
    float mu0 = dot(normal, u_sun), mu = max(dot(normal, view), 0.02);
    // Lumps beyond the terminator lie in the shadow of the rock itself.
    float lit = disc(v_matter.x / max(v_matter.y, 1e-3), u_sun_radius)
        * clamp(0.4 + 5.0 * dot(normalize(v_normal), u_sun), 0.0, 1.0);
    float sunlit = lit, of_rover = rover_visibility(v_relative);
    lit *= of_rover;
    float reflectance = hapke(lit > 0.0 ? mu0 : 0.0, mu, dot(u_sun, view), u_rock_theta,
                              v_matter.z, matter);
    o_radiance = u_irradiance * (reflectance * lit + u_diffuse.y * v_matter.z
                                 * v_around * 0.5 * (1.0 - normal.z));
#ifdef LAMP
    vec3 to_lamp;
    float lamp = lamp_irradiance(v_relative, normalize(v_normal), to_lamp);
    float lamp_radiance = lamp * hapke(dot(normal, to_lamp), mu, dot(to_lamp, view), u_rock_theta,
                                       v_matter.z, matter);
    o_radiance += lamp_radiance;
#else
    const float lamp_radiance = 0.0;
    const vec3 to_lamp = vec3(0.0);
#endif
    vec2 tint = mix(u_rock_tint, u_soil_tint.xy, soil) + 0.4 * u_tint_spread.zw
        * log(max(v_matter.z, 0.2));
    float of_sun = u_irradiance * reflectance * lit;
    tell_tint(tint, vec2(dot(u_sun, view), dot(to_lamp, view)),
              vec3(of_sun, lamp_radiance, o_radiance - of_sun - lamp_radiance));
    o_depth = -dot(v_relative, u_axis);
#ifdef TRUTH
    // That of the face: the one that light is computed with is rounder.
    vec3 face = normalize(cross(dFdx(v_relative), dFdy(v_relative)));
    tell(16.0 + v_index, 0.0, dot(face, v_relative) > 0.0 ? -face : face);
    tell_light(sunlit, of_rover, mu0);
#endif
}
