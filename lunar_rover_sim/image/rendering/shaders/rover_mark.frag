// Which link of the rover is seen.
in vec3 v_relative;
flat in float v_link;
#include "view.glsl"
uniform sampler2D u_depth;      // of all that is seen [m]; see LitTargets
layout(location = 0) out float o_link;

void main() {
    float seen = abs(textureLod(u_depth, gl_FragCoord.xy * u_texel, 0.0).r);
    if (dot(v_relative, u_axis) > 1.001 * seen) discard;
    o_link = (v_link + 1.0) / 255.0;
}
