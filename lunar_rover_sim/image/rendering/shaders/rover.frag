// The rover: a diffuse part by Lambert's law, and gloss (GGX; Walter et al., 2007).
in vec3 v_relative, v_normal, v_local;
in float v_albedo;
flat in vec2 v_tint;            // logarithms of red and blue over green
flat in vec3 v_gloss;           // roughness, reflectance at normal incidence, tilt of crumples
flat in float v_link;
#include "common.glsl"
#ifdef TRUTH
#include "truth.glsl"
#endif
layout(location = 1) out float o_depth;
uniform vec4 u_body_light;      // clearance and occluder distance at the foot and at the top
uniform vec2 u_body_span;       // world height of foot and top [m]
uniform float u_ground_light;   // exitance of the lit ground around the rover [W/m2]
uniform sampler2DShadow u_own_map;      // the rover as the sun sees it
uniform mat4 u_from_sun;        // from world positions to clip space of that map

const float CRUMPLE_M = 0.011;  // size of the facets of crumpled foil
const float METAL = 0.2;        // reflectance beyond which a surface is a metal: it tints its gloss

vec3 crumple(vec3 at) {
    // Facets around random points (Worley, A cellular texture basis function, 1996).
    vec3 corner = floor(at - 0.5), tilt = vec3(0.0);
    float nearest = 1e9;
    for (int k = 0; k < 8; k++) {
        vec3 cell = corner + vec3(k & 1, (k >> 1) & 1, k >> 2);
        uvec3 c = uvec3(ivec3(cell)) * uvec3(0x9e3779b9u, 0x85ebca6bu, 0xc2b2ae35u);
        uint h = c.x ^ c.y ^ c.z;
        h = (h ^ (h >> 15)) * 0x846ca68bu;
        h ^= h >> 16;
        vec3 random = vec3(uvec3(h, h >> 10, h >> 20) & 0x3ffu) * (1.0 / 1023.0) - 0.5;
        vec3 apart = cell + 0.5 + 0.9 * random - at;
        float square = dot(apart, apart);
        if (square < nearest) { nearest = square; tilt = random.zxy; }
    }
    return tilt;
}

// Share of the sun that the rover itself leaves; the mean over a little more than a texel.
float own_visibility(vec3 relative, vec3 normal) {
    vec3 at = relative + u_camera + 0.003 * normal;
    vec3 place = 0.5 + 0.5 * (u_from_sun * vec4(at, 1.0)).xyz;
    vec2 texel = 1.0 / vec2(textureSize(u_own_map, 0));
    float lit = 0.0;
    for (int k = 0; k < 4; k++) {
        vec2 step = vec2(k & 1, k >> 1) - 0.5;
        lit += texture(u_own_map, vec3(place.xy + 1.3 * texel * step, place.z - 0.0015));
    }
    return 0.25 * lit;
}

// Radiance of an irradiance of one from a direction, by gloss; without the cosine of incidence.
float gloss(vec3 normal, vec3 view, vec3 light) {
    vec3 middle = normalize(view + light);
    float alpha2 = v_gloss.x * v_gloss.x, nm = max(dot(normal, middle), 0.0);
    float lm = max(dot(light, middle), 0.1);
    float base = nm * nm * (alpha2 - 1.0) + 1.0;
    float fresnel = v_gloss.y + (1.0 - v_gloss.y) * pow(1.0 - lm, 5.0);
    // Visibility after Kelemen and Szirmay-Kalos, 2001.
    return alpha2 * 0.318309886 / (base * base) * fresnel / (4.0 * lm * lm);
}

void main() {
    vec3 face = normalize(v_normal), view = -normalize(v_relative);
    vec3 normal = face;
    if (v_gloss.z > 0.0) normal = normalize(face + 2.0 * v_gloss.z * crumple(v_local / CRUMPLE_M));
    normal = normalize(normal + view * max(0.02 - dot(normal, view), 0.0));
    float up = clamp((v_relative.z + u_camera.z - u_body_span.x) / max(u_body_span.y - u_body_span.x, 1e-3),
                     0.0, 1.0);
    vec2 light = mix(u_body_light.xy, u_body_light.zw, up);
    float lit = disc(light.x / max(light.y, 1e-3), u_sun_radius);
    float mu0 = max(dot(normal, u_sun), 0.0);
    float own = dot(face, u_sun) > 0.0 ? own_visibility(v_relative, face) : 0.0;
    float sunlight = u_irradiance * lit * own * mu0;
    float metal = v_gloss.y > METAL ? 1.0 : 0.0;
    float diffuse = 0.318309886 * v_albedo * (1.0 - metal * v_gloss.y);
    // What a surface mirrors of the ground; the sky is black.
    vec3 mirrored = reflect(-view, normal);
    float below = smoothstep(-v_gloss.x, v_gloss.x, -mirrored.z);
    float grazing = v_gloss.y + (1.0 - v_gloss.y) * pow(1.0 - max(dot(normal, view), 0.0), 5.0)
        * (1.0 - v_gloss.x);
    float ground = 0.318309886 * u_ground_light;
    float of_sun = diffuse * sunlight, of_ground = diffuse * u_ground_light * 0.5 * (1.0 - normal.z);
    float shine = gloss(normal, view, u_sun) * sunlight, shine_ground = grazing * below * ground;
    float of_lamp = 0.0;
#ifdef LAMP
    // The rover casts no shadow in this light.
    vec3 to_lamp;
    float lamp = lamp_irradiance(v_relative, face, to_lamp) * max(dot(normal, to_lamp), 0.0);
    of_lamp = (diffuse + gloss(normal, view, to_lamp)) * lamp;
#endif
    o_radiance = of_sun + of_ground + shine + shine_ground + of_lamp;
    float whole = max(o_radiance, 1e-9);
    float white = (1.0 - metal) * (shine + shine_ground) / whole;
    o_tint = 0.25 * exp(v_tint * (1.0 - white)
                        + u_soil_tint.xy * ((of_ground + shine_ground) / whole)
                        + u_lamp_tint * (of_lamp / whole));
    o_depth = -dot(v_relative, u_axis);
#ifdef TRUTH
    tell(v_link < 0.5 ? 2.0 : 3.0 + v_link, 0.0, face);
    tell_light(lit, own, dot(face, u_sun));
#endif
}
