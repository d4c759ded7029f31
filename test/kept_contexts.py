"""GL contexts that are used again: the driver compiles its own shaders once in each process."""

from __future__ import annotations

from typing import Any

import moderngl

create_new = moderngl.create_context


class KeptContext:
    """A context that `release` leaves to the next user, in the state of a new one."""

    _free: list[KeptContext] = []

    def __init__(self, context: moderngl.Context) -> None:
        self.__dict__['_context'] = context

    @classmethod
    def create(cls, **options: Any) -> KeptContext:
        """Return a context that nobody else has and make it current, as moderngl does."""
        if not cls._free:
            return cls(create_new(**options))
        kept = cls._free.pop()
        context = kept.__enter__()
        context.gc_mode = None
        context.enable_only(context.NOTHING)
        context.front_face, context.depth_func = 'ccw', '<'
        context.blend_func = context.DEFAULT_BLENDING
        return kept

    def release(self) -> None:
        """Leave it to the next user."""
        self._free.append(self)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._context, name, value)

    def __enter__(self) -> moderngl.Context:
        return self._context.__enter__()

    def __exit__(self, *error: Any) -> None:
        self._context.__exit__(*error)
