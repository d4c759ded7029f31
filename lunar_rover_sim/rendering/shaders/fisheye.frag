// A fisheye image from one of the faces of fisheye_faces.py: mean radiance of PLACES x PLACES places
// in each pixel, and distance; or, with LINK, what part of the rover it shows.
#include "image.glsl"
uniform vec2 u_first_row;       // of this image within its attachments and within those of the face
uniform mat3 u_turn;            // from axes of the camera to those of the face
uniform vec4 u_face;            // focal length, principal point of the face [px]; 1 if it has others beside
uniform vec2 u_face_texel;      // 1 / size of its attachments

// The place in the face that shows a direction, within its attachments.
vec2 place_in_face(vec3 d) { return d.xy / d.z * u_face.x + u_face.yz + vec2(0.5, 0.5 + u_first_row.y); }

#ifdef LINK
uniform sampler2D u_link;
layout(location = 0) out float o_link;
#else
uniform sampler2D u_radiance;   // sampled linearly
uniform sampler2D u_depth;      // see LitTargets
layout(location = 0) out float o_radiance;
layout(location = 1) out float o_distance;

uniform float u_outline;        // least difference of inverse depths of two surfaces [1/m]

// Inverse depth is linear over a plane. Beside an outline it is that of the nearest pixel.
float depth_at(vec2 q) {
    vec2 c = floor(q - 0.5) + 0.5, f = q - c;
    float own = textureLod(u_depth, (floor(q) + 0.5) * u_face_texel, 0.0).r;
    vec4 z = vec4(textureLod(u_depth, c * u_face_texel, 0.0).r,
                  textureLod(u_depth, (c + vec2(1.0, 0.0)) * u_face_texel, 0.0).r,
                  textureLod(u_depth, (c + vec2(0.0, 1.0)) * u_face_texel, 0.0).r,
                  textureLod(u_depth, (c + 1.0) * u_face_texel, 0.0).r);
    if (own == 0.0 || any(equal(z, vec4(0.0)))) return own;
    vec4 n = 1.0 / z;
    if (any(greaterThan(abs(n - 1.0 / own), vec4(u_outline)))) return own;
    return 1.0 / mix(mix(n.x, n.y, f.x), mix(n.z, n.w, f.x), f.y);
}
#endif

void main() {
    vec2 p = gl_FragCoord.xy - vec2(0.5, 0.5 + u_first_row.x);
    if (!shows(p)) discard;
    vec3 ray = u_turn * ray_of(p);
    if (ray.z < u_face.w * max(abs(ray.x), abs(ray.y)) || ray.z <= 0.0) discard;
#ifdef LINK
    o_link = textureLod(u_link, (floor(place_in_face(ray)) + 0.5) * u_face_texel, 0.0).r;
#else
    float sum = 0.0;
    for (int k = 0; k < PLACES * PLACES; k++) {
        vec2 part = (vec2(k % PLACES, k / PLACES) + 0.5) * (1.0 / float(PLACES)) - 0.5;
        sum += textureLod(u_radiance, place_in_face(u_turn * ray_of(p + part)) * u_face_texel, 0.0).r;
    }
    o_radiance = sum * (1.0 / float(PLACES * PLACES));
    o_distance = depth_at(place_in_face(ray)) * length(ray / ray.z);
#endif
}
