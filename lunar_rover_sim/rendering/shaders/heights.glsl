// Heights of the triangles of the finest grid.
uniform sampler2D u_heights;
uniform vec4 u_lattice;         // 1 / cell [1/m], half and last whole index of cells, 1 / samples

float grid_height(vec2 xy) {
    vec2 g = xy * u_lattice.x + u_lattice.y;
    vec2 c = clamp(floor(g), 0.0, u_lattice.z);
    vec2 f = g - c;
    bool lower = f.x >= f.y;
    float texel = u_lattice.w;
    vec2 corner = (c + 0.5) * texel;
    float z00 = textureLod(u_heights, corner, 0.0).r;
    float z11 = textureLod(u_heights, corner + texel, 0.0).r;
    float zc = textureLod(u_heights, corner + (lower ? vec2(texel, 0.0) : vec2(0.0, texel)), 0.0).r;
    vec2 w = lower ? f : f.yx;
    return z00 + w.x * (zc - z00) + w.y * (z11 - zc);
}
