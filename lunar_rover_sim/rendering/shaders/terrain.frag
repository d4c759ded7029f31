// Depth along the optical axis only. The light of each pixel is computed in a later pass.
in vec3 v_relative;
#include "view.glsl"
uniform float u_inner;          // half extent of the finer level inside this one [m]
layout(location = 0) out float o_depth;

void main() {
#ifdef OUTER
    vec2 xy = v_relative.xy + u_camera.xy;
    if (max(abs(xy.x), abs(xy.y)) < u_inner) discard;
#endif
    o_depth = dot(v_relative, u_axis);
}
