// Stray radiance, and as alpha the share of the radiance below that goes where it belongs.
in float v_stray;
uniform float u_direct;
layout(location = 0) out vec4 o_stray;

void main() { o_stray = vec4(v_stray, 0.0, 0.0, u_direct); }
