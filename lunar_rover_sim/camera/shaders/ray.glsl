// The ray through a pixel: relative position at depth 1 along the optical axis, world axes.
uniform vec3 u_ray, u_ray_right, u_ray_down;
uniform int u_first_row;        // of the image in the attachments
vec3 pixel_ray(vec2 p) { return u_ray + u_ray_right * p.x + u_ray_down * p.y; }
vec2 pixel() { return gl_FragCoord.xy - vec2(0.5, 0.5 + float(u_first_row)); }
