// The rover as the sun sees it: nearest surfaces only.
in vec3 a_position;
in vec2 a_part;
uniform mat4 u_links[LINKS];
uniform mat4 u_from_sun;        // from world positions to clip space of the map

void main() {
    gl_Position = u_from_sun * vec4((u_links[int(a_part.y)] * vec4(a_position, 1.0)).xyz, 1.0);
}
