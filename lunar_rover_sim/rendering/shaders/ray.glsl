// The ray through a pixel: relative position at depth 1 along the optical axis, world axes.
vec3 pixel_ray(vec2 p) { return u_ray + u_ray_right * p.x + u_ray_down * p.y; }
vec2 pixel() { return gl_FragCoord.xy - vec2(0.5, 0.5 + u_first_row); }
