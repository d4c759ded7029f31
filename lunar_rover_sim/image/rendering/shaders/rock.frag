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

void main() {
    vec3 face = normalize(cross(dFdx(v_relative), dFdy(v_relative)));
    face = dot(face, v_relative) > 0.0 ? -face : face;
    // Each vertex of a solid is one of several faces: its normal tells how round these look.
    vec3 rounder = normalize(v_normal + (dot(v_normal, v_normal) < 0.2 ? face : vec3(0.0)));
    vec3 normal = rounder;
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
    // Soil lies banked up at the foot, and thinly on what faces up.
    float bank = v_diameter * (0.1 + 0.25 * (lumps.x - 0.35));
    float soil = 1.0 - smoothstep(0.4 * bank, bank, v_height);
    soil = max(soil, 0.5 * smoothstep(0.7, 0.95, normal.z + 0.6 * (lumps.y - 0.5)));
    soil *= min(u_rough, 1.0);
    normal = normalize(mix(normal, vec3(0.5 * normal.xy, 0.87), soil));
    vec3 side = normalize(cross(normal, vec3(0.37, 0.71, 0.6)));
    normal = normalize(normal + tilt.x * side + tilt.y * cross(normal, side));
    Hapke matter = Hapke(mix(u_rock.w, u_regolith.w, soil), mix(u_rock.b, u_regolith.b, soil),
                         mix(u_rock.c, u_regolith.c, soil), mix(u_rock.b_s0, u_regolith.b_s0, soil),
                         mix(u_rock.h_s, u_regolith.h_s, soil));
    float mu0 = dot(normal, u_sun), mu = max(dot(normal, view), 0.02);
    // Lumps beyond the terminator lie in the shadow of the rock itself.
    float lit = disc(v_matter.x / max(v_matter.y, 1e-3), u_sun_radius)
        * clamp(0.4 + 5.0 * dot(rounder, u_sun), 0.0, 1.0);
    float sunlit = lit, of_rover = rover_visibility(v_relative);
    lit *= of_rover;
    float reflectance = hapke(lit > 0.0 ? mu0 : 0.0, mu, dot(u_sun, view), u_rock_theta,
                              v_matter.z, matter);
    o_radiance = u_irradiance * (reflectance * lit + u_diffuse.y * v_matter.z
                                 * v_around * 0.5 * (1.0 - normal.z));
#ifdef LAMP
    vec3 to_lamp;
    float lamp = lamp_irradiance(v_relative, rounder, to_lamp);
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
    // Light is computed with a rounder one.
    tell(16.0 + v_index, 0.0, face);
    tell_light(sunlit, of_rover, mu0);
#endif
}
