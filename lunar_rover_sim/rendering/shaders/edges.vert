// A triangle that covers the viewport, at a depth in clip space.
uniform float u_z;

void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, u_z, 1.0);
}
