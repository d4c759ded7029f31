// Lit regolith: slope and shadow of the grid, finer relief, albedo, indirect light.
#include "common.glsl"
#include "ray.glsl"
#include "relief.glsl"
#include "relief_share.glsl"
#ifdef RELIEF
uniform sampler2D u_relief;     // height over the grid [m], bound of the slopes around; wraps around
uniform float u_relief_scale;   // 1 / its extent [1/m]
const float RELIEF_TEXEL = 0.003125;    // of it [m]
#ifdef LAMP
#include "lamp_relief.glsl"
#endif
#endif
#ifdef TRACKS
#include "tracks.glsl"
#endif
uniform sampler2D u_depth;
uniform sampler2DArray u_ground;    // slope x, slope y, clearance, occluder distance
// Albedo / 2, roots of 4 irradiance scattered here and around; on the finest level the share of the
// sun that is seen, on the others the share of ground in the shadow of far rocks.
uniform sampler2DArray u_matter;
// Of each level: scale and offset from metres to texture units, log2 of texels per metre, half
// extent [m].
uniform vec4 u_level[LEVELS];
uniform Hapke u_regolith;
uniform vec3 u_heading;         // to the sun over level ground; tangent of its elevation

layout(location = 1) out float o_depth;
uniform vec2 u_diffuse;         // diffuse albedo / pi of ground and rocks
#ifdef TRUTH
#include "ground_truth.glsl"
#endif

// Sampled at pixel centres: on llvmpipe texelFetch takes longer, since it checks bounds.
float depth_at(vec2 p) { return textureLod(u_depth, p * u_texel, 0.0).r; }

// Most pixels use a single mip level, which halves the work; levels still change smoothly.
float mip(float level) {
    float whole = floor(level);
    return max(whole + clamp((level - whole - 0.35) * (1.0 / 0.3), 0.0, 1.0), 0.0);
}

// Texels are means that are interpolated besides, and as wide as they are long: ones of the size of
// a pixel blur more than the pixel does. With this offset as many pixels are in shadow as should be.
const float SHARPER = 0.3;

void main() {
    float depth = depth_at(gl_FragCoord.xy);
    vec3 ray = pixel_ray(pixel());
    o_depth = depth;
    vec3 relative = ray * depth;
    vec2 xy = relative.xy + u_camera.xy;
    float reach = max(abs(xy.x), abs(xy.y));
    vec4 grid = u_level[0];
    float layer = 0.0;
    for (int k = 1; k < LEVELS; k++) {
        if (reach > u_level[k - 1].w) { grid = u_level[k]; layer = float(k); }
    }
    vec3 uv = vec3(xy * grid.x + grid.y, layer);
#ifndef UNLIT
    vec3 view = -normalize(ray);
    // Footprint of the pixel on level ground: across and along the line of sight.
    float size = depth * u_pixel;
    float along = min(size / max(abs(view.z), 0.02), 4.0 * size);
    float level = log2(along);
    float coarse = mip(level + grid.z);
    vec4 ground = textureLod(u_ground, uv, coarse);
    // Far rocks' shadows are as narrow as a pixel: they are not blurred along the view.
    vec4 matter = textureLod(u_matter, uv, layer > 0.0 ? max(log2(size) + grid.z, 0.0)
                                                       : coarse);
    // Relief below the grid has the most contrast: little of it may be left out along the view,
    // on slopes that turn away from the camera either.
    float facing = dot(normalize(vec3(-ground.xy, 1.0)), view);
    // Where relief has shape, rays meet what faces them.
    float shaped = relief_share(xy);
    facing = max(facing, shaped);
    float footprint = min(size / max(facing, 0.02), 12.0 * size);
    float detail = min(mip(log2(footprint) + u_tile.w - SHARPER), float(RELIEF_LEVELS - 1));
    vec4 scales = relief_scales(detail);
    Relief relief = relief_at(xy, detail);
    Hapke soil = u_regolith;
    float albedo = 2.0 * matter.r;
#ifdef TRACKS
    // Relief below the grid is pressed flat in prints, and partly buried beside them.
    Print print = print_at(xy, level);
    float untouched = u_heading.z - dot(ground.xy, u_heading.xy);
    float kept = 1.0 - max(print.pressed, 0.6 * print.loose);
    ground.xy += print.slope;
    relief.slope_a *= kept;
    relief.slope_b *= kept;
    scales.x = mix(u_trodden.z, scales.x, kept);
    albedo *= 1.0 - dot(u_trodden.xy, vec2(print.pressed, print.loose));
    soil.c += u_trodden.w * print.pressed;
#endif
    vec2 slope = ground.xy + relief.slope_a + relief.slope_b;
    vec3 normal = normalize(vec3(-slope, 1.0));
    // Faces of the fine relief that turn away from the camera are hidden by those that face it.
    vec3 up = normalize(vec3(-ground.xy, 1.0));
    float cosine = dot(up, view);
    float least = clamp(cosine, 0.02, 0.08);
    normal = normalize(normal + view * max(least - dot(normal, view), 0.0));
    vec2 heading = u_heading.xy;
    float tangent = u_heading.z - dot(ground.xy, heading);
    float width = u_sun_radius * (1.0 + tangent * tangent);
    // Clearances make a crisp edge, but their mean is none: coarser mip levels of the finest
    // grid are of visibility.
    float angle = ground.z / ground.w, half_width = u_sun_radius;
#ifdef SMOOTH
    // A pixel shows the mean of its light. Angles may jump from one occluder to the next, but
    // not between those where light changes; very near ones are part of the relief.
    float most = ground.w > 4.0 * footprint ? footprint / ground.w : 0.0;
    angle = clamp(angle, -u_sun_radius - most, u_sun_radius + most);
    half_width += 0.5 * min(length(vec2(dFdx(angle), dFdy(angle))), most);
#endif
    float lit = disc(angle, half_width);
    lit = layer > 0.0 ? lit * (1.0 - matter.a) : mix(lit, matter.a, min(coarse, 1.0));
    float drawn = disc(tangent - relief.horizon.x, width + scales.y)
        * disc(tangent - dot(relief.slope_a, heading) - relief.horizon.y, width + scales.z);
    float sunlit = drawn;       // gain and factor are of brightness
    drawn *= scales.w / (1.0 + (scales.w - 1.0) * drawn);
    drawn *= mix(relief_factor(detail, cosine, dot(up, u_sun), dot(u_sun, view), tangent), 1.0,
                 shaped);
#ifdef TRACKS
    float beside = mix(disc(untouched - print.horizon, width), print.seen, print.coarse);
    drawn = mix(1.0, drawn, kept) * beside;
    sunlit = mix(1.0, sunlit, kept) * beside;
#endif
    sunlit *= lit;
    lit *= drawn;
    float of_rover = 1.0;
#ifdef ROVER_SHADOW
    of_rover = rover_visibility(relative);
    lit *= of_rover;
#endif
    float mu0 = dot(normal, u_sun), mu = max(dot(normal, view), 0.02);
    float reflectance = hapke(lit > 0.0 ? mu0 : 0.0, mu, dot(u_sun, view),
                              scales.x, albedo, soil);
#ifdef LAMP
    vec3 to_lamp;
    float lamp = lamp_irradiance(relative, up, to_lamp);
#ifdef RELIEF
#ifdef TRACKS
    lamp *= lamp_over_relief(xy, up, to_lamp, kept);
#else
    lamp *= lamp_over_relief(xy, up, to_lamp, 1.0);
#endif
#endif
    float lamp_radiance = lamp * hapke(dot(normal, to_lamp), mu, dot(to_lamp, view),
                                       scales.x, albedo, soil);
#else
    const float lamp_radiance = 0.0;
    const vec3 to_lamp = vec3(0.0);
#endif
    float scattered = matter.g * matter.g + matter.b * matter.b * 0.5 * (1.0 - normal.z);
    o_radiance = u_irradiance * (reflectance * lit + 0.25 * u_diffuse.x * albedo * scattered)
        + lamp_radiance;
    float of_sun = u_irradiance * reflectance * lit;
    tell_tint(soil_tint(xy, albedo), vec2(dot(u_sun, view), dot(to_lamp, view)),
              vec3(of_sun, lamp_radiance, o_radiance - of_sun - lamp_radiance));
#ifdef TRUTH
    tell_light(sunlit, of_rover, mu0);
#endif
#endif
#ifdef TRUTH
    tell_ground(xy, uv, grid.w);
#endif
}
