"""Drawing with OpenGL: context, passes, shaders, and the renderer that composes them."""
