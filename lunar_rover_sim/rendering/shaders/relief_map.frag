// The shape of the relief below the grid: heights of both tiles, and how steeply they rise.
#include "relief_place.glsl"
#include "heights.glsl"
uniform sampler2D u_shape_a, u_shape_b; // height [m], bound of the slopes around
in vec2 v_xy;
layout(location = 0) out vec2 o_shape;

// One copy of a tile passes into the next one over some centimetres, without a step.
const float SOFT = 3.0;

vec2 shape(vec4 at) {
    // Four texels of tile b are as long as one of the map.
    return textureLod(u_shape_a, at.xy, 0.0).rg + textureLod(u_shape_b, at.zw, 2.0).rg;
}

void main() {
    Placed place = placed_at(v_xy);
    float lead = textureLod(u_tile_a, place.first.xy, 0.0).w
        - textureLod(u_tile_a, place.second.xy, 0.0).w;
    float other = clamp(0.5 - SOFT * (place.lead + lead), 0.0, 1.0);
    o_shape = mix(shape(place.first), shape(place.second), other);
    o_shape.x += grid_bend(v_xy);
}
