// Shadow of the relief below the grid under the lamp, where it has shape.
uniform vec2 u_relief_most;     // greatest height of the relief [m], and half of the finest grid

const float LAMP_EDGE = 4e-4;           // height over which a shadow sets in [m]

// Share of the lamp's light that passes over the relief. Steps towards it are as long as the slopes
// around a point allow.
// normal: of the grid; kept: share of the relief that tracks have left
float lamp_over_relief(vec2 xy, vec3 normal, vec3 to_lamp, float kept) {
    float shape = kept * relief_share(xy);
    float rise = max(dot(normal, to_lamp), 0.01);
    vec2 heading = normalize(to_lamp.xy);
    float tangent = rise * inversesqrt(max(1.0 - rise * rise, 1e-4));
    float own = textureLod(u_relief, xy * u_relief_scale, 0.0).r * shape;
    float open = 1.0, along = 0.5 * RELIEF_TEXEL;
    int steps = shape > 0.0 ? 20 : 0;
    for (int i = 0; i < steps; i++) {
        float ray = own + tangent * along;
        if (ray > u_relief_most.x || open <= 0.0) break;
        vec2 relief = textureLod(u_relief, (xy + along * heading) * u_relief_scale, 0.0).rg * shape;
        float over = ray - relief.r;
        open = min(open, 0.5 + over / LAMP_EDGE);
        along += max(over / max(relief.g - tangent, 0.02), 0.5 * RELIEF_TEXEL);
    }
    return clamp(open, 0.0, 1.0);
}
