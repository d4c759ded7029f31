// A block of the map of relief, in its place there, which it shares with blocks far away.
in vec2 i_block;
out vec2 v_xy;                  // [m]

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    v_xy = (i_block + corner) * BLOCK_M;
    vec2 place = i_block - BLOCKS * floor((i_block + 0.5) / BLOCKS) + corner;
    gl_Position = vec4(2.0 * place / BLOCKS - 1.0, 0.0, 1.0);
}
