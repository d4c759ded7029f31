// Adds the Earth's disc, which was computed pixel by pixel, to the radiance of the sky.
uniform sampler2D u_patch;
uniform sampler2D u_depth;      // 0: sky
uniform vec2 u_corner;          // of the patch, within the attachments [px]
layout(location = 0) out float o_radiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    if (texelFetch(u_depth, pixel, 0).r != 0.0) discard;
    o_radiance = texelFetch(u_patch, ivec2(gl_FragCoord.xy - u_corner), 0).r;
}
