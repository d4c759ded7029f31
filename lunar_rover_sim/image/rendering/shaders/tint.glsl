// Colour: red and blue over green of what is seen. Radiance is that of the green band.
layout(location = 2) out vec2 o_tint;   // over 4, as image/camera/mosaic.py reads it; 0 is the sky
uniform vec4 u_soil_tint;       // logarithms at 30 deg of phase, and their slopes (colours.py)
uniform vec2 u_rock_tint;
uniform vec4 u_tint_spread;     // of the patches; change with the logarithm of albedo
uniform vec2 u_lamp_tint;       // of the light of the lamp over that of the sun, logarithms

// Reddening with the phase angle.
vec2 phase_tint(float cos_g) { return u_soil_tint.zw * (sqrt(0.5 - 0.5 * cos_g) - 0.258819); }

// cosines: of the phase angles of sun and lamp; light: radiance of the sun, of the lamp, and what
// has been reflected by the ground before, and has its colour, too
void tell_tint(vec2 tint, vec2 cosines, vec3 light) {
    light /= max(light.x + light.y + light.z, 1e-9);
    float of_lamp = light.y, direct = light.x + light.y;
    float cos_g = (cosines.x * light.x + cosines.y * light.y) / max(direct, 1e-3);
    vec2 twice = u_soil_tint.xy * light.z;
    o_tint = 0.25 * exp(tint + phase_tint(cos_g) * direct + twice + u_lamp_tint * of_lamp);
}
