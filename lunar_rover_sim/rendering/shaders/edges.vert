// A rectangle of the pair of images.
in vec4 i_box;                  // opposite corners, in clip space
uniform float u_z;
void main() {
    gl_Position = vec4(mix(i_box.xy, i_box.zw, vec2(gl_VertexID & 1, gl_VertexID >> 1)), u_z, 1.0);
}
