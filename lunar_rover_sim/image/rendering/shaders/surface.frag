// What is where: rocks and the rover, which compiled loops light (object_light.py).
in vec3 v_relative, v_normal;
flat in float v_number;         // of a rock; -1 - that of a part of the rover
#include "view.glsl"
layout(location = 0) out float o_depth;     // negative, as what is drawn here is marked [m]
layout(location = 1) out uvec2 o_surface;   // the normal of light, packed; the number
layout(location = 2) out vec4 o_face;       // the true normal

// A unit vector on an octahedron, unfolded (Meyer et al., 2010, On floating-point normal vectors).
uint code_of(vec3 n) {
    n /= abs(n.x) + abs(n.y) + abs(n.z);
    vec2 at = n.z < 0.0 ? (1.0 - abs(n.yx)) * vec2(n.x < 0.0 ? -1.0 : 1.0, n.y < 0.0 ? -1.0 : 1.0)
        : n.xy;
    uvec2 code = uvec2(round((0.5 + 0.5 * at) * 65535.0));
    return code.x | code.y << 16;
}

void main() {
    vec3 face = normalize(cross(dFdx(v_relative), dFdy(v_relative)));
    face = dot(face, v_relative) > 0.0 ? -face : face;
    if (v_number < 0.0) face = normalize(v_normal);
    // Each vertex of a solid is one of several faces: its normal tells how round these look.
    vec3 normal = normalize(v_normal + (dot(v_normal, v_normal) < 0.2 ? face : vec3(0.0)));
    o_depth = -dot(v_relative, u_axis);
    o_surface = uvec2(code_of(normal), uint(int(v_number)));
    o_face = vec4(face, 0.0);
}
