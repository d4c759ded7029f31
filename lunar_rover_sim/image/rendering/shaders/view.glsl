// One camera (projection.py). Vectors are in world axes.
layout(std140) uniform View {
    mat4 u_clip;                // from positions relative to the camera to clip space
    vec3 u_camera;              // world position [m]
    float u_pixel;              // size of a pixel at depth 1
    vec3 u_axis;                // direction of the optical axis
};
