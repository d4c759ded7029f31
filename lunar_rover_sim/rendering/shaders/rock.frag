// A lit rock face.
in vec3 v_relative, v_normal, v_local;
in vec3 v_matter;
flat in float v_around;
flat in float v_index;
flat in float v_diameter;
#include "common.glsl"
#ifdef TRUTH
#include "truth.glsl"
#else
layout(location = 1) out float o_depth;
#endif
uniform sampler2D u_tile_a;
uniform vec4 u_grain;           // 1 / period and strength of grain; periods and strength of lumps
uniform vec2 u_diffuse;         // diffuse albedo / pi of ground and rocks
uniform float u_rock_theta;
uniform Hapke u_rock;
uniform float u_mark;           // -1: the outline will be smoothed, see edges.frag; else 1

void main() {
    vec3 normal = normalize(v_normal);
#ifdef TRUTH
    // That of the face: the one that light is computed with is rounder.
    normal = normalize(cross(dFdx(v_relative), dFdy(v_relative)));
    if (dot(normal, v_relative) > 0.0) normal = -normal;
    tell(16.0 + v_index, 0.0, normal, disc(v_matter.x / max(v_matter.y, 1e-3), u_sun_radius),
         rover_visibility(v_relative));
#else
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
    vec3 side = normalize(cross(normal, vec3(0.37, 0.71, 0.6)));
    normal = normalize(normal + tilt.x * side + tilt.y * cross(normal, side));
    float mu0 = dot(normal, u_sun), mu = max(dot(normal, view), 0.02);
    // Lumps beyond the terminator lie in the shadow of the rock itself.
    float lit = disc(v_matter.x / max(v_matter.y, 1e-3), u_sun_radius)
        * clamp(0.4 + 5.0 * dot(normalize(v_normal), u_sun), 0.0, 1.0);
#ifdef ROVER_SHADOW
    lit *= rover_visibility(v_relative);
#endif
    float reflectance = hapke(lit > 0.0 ? mu0 : 0.0, mu, dot(u_sun, view), u_rock_theta, v_matter.z, u_rock);
    o_radiance = u_irradiance * (reflectance * lit + u_diffuse.y * v_matter.z
                                 * v_around * 0.5 * (1.0 - normal.z));
#ifdef LAMP
    vec3 to_lamp;
    float lamp = lamp_irradiance(v_relative, normalize(v_normal), to_lamp);
    o_radiance += lamp * hapke(dot(normal, to_lamp), mu, dot(to_lamp, view), u_rock_theta,
                               v_matter.z, u_rock);
#endif
    o_radiance = u_mark * max(o_radiance, 1e-30);
    o_depth = dot(v_relative, u_axis);
#endif
}
