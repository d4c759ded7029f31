// Adds the sun's disc, which was computed pixel by pixel, to the radiance.
uniform sampler2D u_patch;
uniform vec2 u_corner;          // of the patch, within the attachments [px]
layout(location = 0) out float o_radiance;

void main() { o_radiance = texelFetch(u_patch, ivec2(gl_FragCoord.xy - u_corner), 0).r; }
