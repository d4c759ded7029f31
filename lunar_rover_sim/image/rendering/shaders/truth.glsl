// What is true of a pixel: its numbers, its normal, and how much of the sun its light comes from.
layout(location = 3) out vec4 o_ids;        // label and crater, each as low and high byte
layout(location = 4) out vec4 o_normal;     // unit vector in world axes
#ifndef UNLIT
layout(location = 5) out vec4 o_shadow;     // shares of the sun's disc: seen, hidden by the rover
                                            // alone; and how far from all or none is seen
#endif

vec2 bytes(float number) {
    float high = floor(number * (1.0 / 256.0));
    return vec2(number - 256.0 * high, high) * (1.0 / 255.0);
}

void tell(float label, float crater, vec3 normal) {
    o_ids = vec4(bytes(min(label, 65535.0)), bytes(crater));
    o_normal = vec4(normal, 0.0);
}

#ifndef UNLIT
// seen: share of the disc that all but the rover leaves; of_rover: that the rover leaves
// mu0: cosine of incidence on the surface that is lit
void tell_light(float seen, float of_rover, float mu0) {
    seen = u_irradiance > 0.0 ? min(seen, disc(mu0, u_sun_radius)) : 0.0;
    float both = seen * of_rover;
    o_shadow = vec4(both, seen - both, 1.0 - abs(2.0 * both - 1.0), 1.0);
}
#endif
