// A mesh over the image, with the stray light at its corners.
in vec2 a_place;                // over the size of the image
in float a_stray;
out float v_stray;

void main() {
    v_stray = a_stray;
    gl_Position = vec4(2.0 * a_place - 1.0, 0.0, 1.0);
}
