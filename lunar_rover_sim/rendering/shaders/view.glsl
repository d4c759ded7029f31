// One camera (view.py). Vectors are in world axes.
layout(std140) uniform View {
    mat4 u_clip;                // from positions relative to the camera to clip space
    vec3 u_camera;              // world position [m]
    float u_above;              // height of the centre of all cameras above the ground [m]
    vec3 u_axis;                // direction of the optical axis
    float u_pixel;              // size of a pixel at depth 1
    vec3 u_ray;                 // through pixel (0, 0), to depth 1; its steps per pixel follow
    float u_first_row;          // of the image within the attachments
    vec3 u_ray_right;
    vec3 u_ray_down;
    vec2 u_texel;               // 1 / size of the attachments
    vec2 u_centre;              // of all cameras, relative to this one
};
