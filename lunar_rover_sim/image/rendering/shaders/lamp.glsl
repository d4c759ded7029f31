// The light of the rover's lamp, with its shadow map.
uniform vec3 u_lamp, u_lamp_axis;       // position relative to the camera, axis
uniform vec2 u_lamp_beam;               // peak intensity [W/sr], exponent of the cosine
uniform mat4 u_lamp_clip;               // from the lamp's own relative axes
uniform sampler2D u_lamp_depth;
uniform float u_lamp_pixel;             // angle of a pixel of the map [rad]

// Normal irradiance [W/m2] at a point with a coarse normal, and the unit vector to the lamp.
float lamp_irradiance(vec3 relative, vec3 normal, out vec3 to_lamp) {
    vec3 arm = relative - u_lamp;
    float square = dot(arm, arm);
    to_lamp = -arm * inversesqrt(square);
    float cosine = max(-dot(to_lamp, u_lamp_axis), 1e-3);
    vec4 q = u_lamp_clip * vec4(arm, 1.0);
    vec2 at = (0.5 + 0.5 * q.xy / max(q.w, 1e-6)) * vec2(textureSize(u_lamp_depth, 0)) - 0.5;
    // A pixel of the map covers a range of depths, which is the wider the more grazing the light is.
    float slack = 0.004 + u_lamp_pixel / max(dot(normal, to_lamp), 0.04);
    float own = dot(arm, u_lamp_axis) * (1.0 - slack) - 0.01;
    vec2 cell = floor(at), part = at - cell;
    float lit = 0.0;
    for (int i = 0; i < 4; i++) {
        ivec2 step = ivec2(i & 1, i >> 1);
        // Negative for rocks; see LitTargets.
        float stored = abs(texelFetch(u_lamp_depth, clamp(ivec2(cell) + step, ivec2(0),
                                                          textureSize(u_lamp_depth, 0) - 1), 0).r);
        vec2 weight = mix(1.0 - part, part, vec2(step));
        lit += stored == 0.0 || own < stored ? weight.x * weight.y : 0.0;
    }
    return q.w > 0.0 ? lit * u_lamp_beam.x * pow(cosine, u_lamp_beam.y) / square : 0.0;
}
