"""The mistakes this package knows: one root, one subclass per kind.

Each message is one line that names the parameter or file, the value, and what is valid. The
command line prints it and exits with 1; nodes log it as fatal and exit with 1.
"""

from __future__ import annotations

_MOST_CHARACTERS = 1500


class LunarRoverSimError(Exception):
    """Root of every error that a user can cause and mend; its message is one printable line."""

    def __init__(self, message: object = '') -> None:
        text = str(message)
        if not text.isprintable():
            # Names and values of untrusted files must not reach a terminal as they are.
            text = ''.join(c if c.isprintable() else repr(c)[1:-1] for c in text)
        if len(text) > _MOST_CHARACTERS:
            text = text[:_MOST_CHARACTERS] + ' ...'
        super().__init__(text)


class ConfigError(LunarRoverSimError):
    """A parameter is unknown, of the wrong type, or out of its range."""


class WorldError(LunarRoverSimError):
    """A world, elevation model or mesh cannot be read, built or used."""


class PhysicsError(LunarRoverSimError):
    """The simulation diverged or was asked for something it cannot do."""


class RenderError(LunarRoverSimError):
    """No usable EGL device, or the renderer was asked for something it cannot do."""


class BagError(LunarRoverSimError):
    """A bag cannot be written, read or trusted."""


class EvaluationError(LunarRoverSimError):
    """Trajectories cannot be associated, aligned or compared."""


class ProcessError(LunarRoverSimError):
    """A program cannot be started, or did not end as it should."""


class GraphError(LunarRoverSimError):
    """A node died, stayed silent, or ROS 2 is not to be had."""
