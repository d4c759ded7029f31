// What is true of a pixel: its numbers, how the sun lights it, its normal.
layout(location = 0) out vec4 o_ids;        // label and crater, each as low and high byte
layout(location = 1) out vec4 o_shadow;     // shares of the sun's disc: seen, hidden by the rover
                                            // alone; and how far from all or none is seen
layout(location = 2) out vec4 o_normal;     // unit vector in world axes

vec2 bytes(float number) {
    float high = floor(number * (1.0 / 256.0));
    return vec2(number - 256.0 * high, high) * (1.0 / 255.0);
}

// seen: share of the disc that ground and rocks leave; of_rover: that the rover leaves
void tell(float label, float crater, vec3 normal, float seen, float of_rover) {
    seen = min(seen, disc(dot(normal, u_sun), u_sun_radius));
    float both = seen * of_rover;
    o_ids = vec4(bytes(min(label, 65535.0)), bytes(crater));
    o_shadow = vec4(both, seen - both, 1.0 - abs(2.0 * both - 1.0), 1.0);
    o_normal = vec4(normal, 0.0);
}
