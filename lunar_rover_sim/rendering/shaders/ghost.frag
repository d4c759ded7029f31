// An image of the aperture that sunlight makes by reflection within the lens.
uniform vec3 u_ghost;           // place within the attachments [px], radius [px]
uniform float u_radiance;
layout(location = 0) out vec4 o_stray;

void main() {
    float inside = u_ghost.z - distance(gl_FragCoord.xy, u_ghost.xy);
    o_stray = vec4(u_radiance * clamp(inside + 0.5, 0.0, 1.0), 0.0, 0.0, 1.0);
}
