"""The OpenGL context, without a window, on a GPU or Mesa's llvmpipe; who owns its objects."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import functools
from importlib import resources
import logging
import os
import re
from typing import Any, Protocol, TypeVar

import moderngl
import numpy as np

from lunar_rover_sim.base.errors import RenderError


class Releasable(Protocol):
    """A GL object, or an owner of some."""

    def release(self) -> Any:
        """Release them."""


Owned = TypeVar('Owned', bound=Releasable)


class GlOwner:
    """A base class for what is made of several objects of one context."""

    def __init__(self) -> None:
        self._owned = contextlib.ExitStack()

    @contextlib.contextmanager
    def _making(self) -> Iterator[None]:
        """Release what is owned so far if making the rest fails."""
        try:
            yield
        except Exception:
            self.release()
            raise

    def _own(self, item: Owned) -> Owned:
        """Have an object released with this one."""
        self._owned.callback(item.release)
        return item

    def release(self) -> None:
        """Release the GL objects."""
        self._owned.close()


log = logging.getLogger(__name__)


def create_context() -> moderngl.Context:
    """Return a standalone EGL context of OpenGL 3.3 core or later.

    Raises:
        RenderError: If there is no usable device; the error names the packages to install.
    """
    if 'LP_NATIVE_VECTOR_WIDTH' in os.environ:
        # Mesa's cache does not tell code of one width from that of another, which writes beyond
        # the memory that it is given: the heap is corrupt when rocks are drawn.
        os.environ['MESA_SHADER_CACHE_DISABLE'] = 'true'
    try:
        context = moderngl.create_context(
            standalone=True, backend='egl', require=330)  # type: ignore[arg-type]
    except Exception as error:  # moderngl raises a bare Exception
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RenderError(f'no usable EGL device ({reason}); install the packages '
                          'libegl1 libgl1 libgl1-mesa-dri') from None
    # Images are drawn with their first row at the bottom: faces towards the camera are clockwise.
    context.front_face = 'cw'
    log.info('rendering on %s', context.info['GL_RENDERER'])
    return context


def load_program(context: moderngl.Context, vertex: str, fragment: str,
                 **defines: Any) -> moderngl.Program:
    """Compile shaders/<vertex>.vert and <fragment>.frag with `defines` set.

    `#include "name.glsl"` lines are replaced by that file.

    Raises:
        RenderError: If the driver cannot compile the result.
    """
    head = '#version 330 core\n' + ''.join(f'#define {name} {value}\n'
                                           for name, value in defines.items())
    try:
        return context.program(vertex_shader=head + source(f'{vertex}.vert'),
                               fragment_shader=head + source(f'{fragment}.frag'))
    except Exception as error:
        lines = [line for line in str(error).splitlines() if 'rror' in line] or [str(error)]
        raise RenderError(f'the driver refuses shader {vertex}/{fragment}: {lines[-1]}') from None


@functools.cache
def source(name: str) -> str:
    """Return the text of one shader file with its includes."""
    path = resources.files('lunar_rover_sim.image.rendering').joinpath('shaders').joinpath(name)
    text = path.read_text(encoding='utf-8')
    return re.sub(r'^#include "([\w.]+)"$', lambda match: source(match.group(1)), text,
                  flags=re.MULTILINE)


def set_uniform(program: moderngl.Program, **values: Any) -> None:
    """Set uniforms by name; those that the compiler removed are skipped."""
    for name, value in values.items():
        member: Any = program.get(name, None)
        if member is not None:
            if isinstance(value, np.ndarray):
                member.write(value.tobytes())
            else:
                member.value = value


def clear_window(target: moderngl.Framebuffer, window: tuple[int, int, int, int]) -> None:
    """Make a window (x, y, width, height) of a framebuffer the target, and clear it."""
    target.use()
    target.viewport = window
    target.clear(viewport=window)


def release_all(*items: Releasable) -> None:
    """Release GL objects."""
    for item in items:
        item.release()
