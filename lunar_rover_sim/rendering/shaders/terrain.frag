// Depth along the optical axis only. The light of each pixel is computed in a later pass.
in vec3 v_relative;
#include "view.glsl"
uniform float u_inner;          // half extent of the finer level inside this one [m]
layout(location = 0) out float o_depth;
#ifdef CUT
uniform sampler2D u_cut;        // 1 where a block of tracks is drawn instead; wraps around
uniform float u_cut_scale;      // 1 / its extent [1/m]
#endif

void main() {
#ifdef OUTER
    vec2 xy = v_relative.xy + u_camera.xy;
    if (max(abs(xy.x), abs(xy.y)) < u_inner) discard;
#endif
#ifdef CUT
    if (textureLod(u_cut, (v_relative.xy + u_camera.xy) * u_cut_scale, 0.0).r > 0.5) discard;
#endif
    o_depth = 1.0 / gl_FragCoord.w;     // of clip space, which is along the optical axis
}
