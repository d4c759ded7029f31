"""The errors of this package: one root, one subclass per subject.

Each message is one line that names the parameter or file, the value, and what is valid. The
command line prints it and exits with 1; nodes log it as fatal and exit with 1. A room raises the
error of its subject, and `ConfigError` for a parameter or argument.
"""

from __future__ import annotations

from collections.abc import Iterable
import difflib
import os
import reprlib
import textwrap

PIPE_COLUMNS = 100      # of what is printed where there is no terminal
_MAX_CHARACTERS = 1500


class LunarRoverSimError(Exception):
    """Root of every error that a user can cause and correct; its message is one printable line."""

    def __init__(self, message: object = '') -> None:
        text = str(message)
        if not text.isprintable():
            # Names and values from untrusted files may contain control characters.
            text = ''.join(c if c.isprintable() else repr(c)[1:-1] for c in text)
        if len(text) > _MAX_CHARACTERS:
            text = text[:_MAX_CHARACTERS] + ' ...'
        super().__init__(text)


class ConfigError(LunarRoverSimError):
    """A parameter or argument is unknown, of the wrong type, or out of its range."""


class WorldError(LunarRoverSimError):
    """A world, elevation model or mesh cannot be read, built or used."""


class PhysicsError(LunarRoverSimError):
    """The simulation diverged or was asked for something it cannot do."""


class GroundLeftError(PhysicsError):
    """The rover walked over the edge of the ground."""


class GaitError(LunarRoverSimError):
    """The gait controller was given something it cannot walk with."""


class RenderError(LunarRoverSimError):
    """No EGL device is usable, or the renderer was asked for something it cannot do."""


class StereoError(LunarRoverSimError):
    """Images cannot be matched."""


class BagError(LunarRoverSimError):
    """A bag cannot be written, read or trusted."""


class GraphError(LunarRoverSimError):
    """ROS 2 is missing, or a node died or did not answer."""


class SequenceError(LunarRoverSimError):
    """A recording cannot be exported to the format of a data set."""


class UsdError(LunarRoverSimError):
    """OpenUSD is missing, or a stage cannot be written."""


class EvaluationError(LunarRoverSimError):
    """Trajectories cannot be associated, aligned or compared."""


class ProcessError(LunarRoverSimError):
    """A program cannot be started, or failed."""


class SlamError(LunarRoverSimError):
    """A SLAM system cannot be run, or its result cannot be read."""


class StudyError(LunarRoverSimError):
    """A study cannot be carried out, or its data do not suffice."""


class LearningError(LunarRoverSimError):
    """An environment, an action or a policy cannot be used."""


class NavigationError(LunarRoverSimError):
    """Depth, poses or goals that a navigator cannot use."""


class CampaignError(LunarRoverSimError):
    """A campaign cannot be planned, recorded or published."""


def with_extra(name: str) -> str:
    """Return how to install what an extra of this package brings."""
    return (f"pip install '.[{name}]' in a clone of lunar_rover_sim, or "
            f"'lunar_rover_sim-VERSION.whl[{name}]'")


def one_line(reason: object) -> str:
    """Return a text, or the text of an error or else the name of its class, on one line."""
    return ' '.join(str(reason).split()) or (
        type(reason).__name__ if isinstance(reason, BaseException) else '')


def folded(line: str, columns: int = PIPE_COLUMNS) -> str:
    """Return a line folded to a width; words as long as paths stay whole."""
    return textwrap.fill(line, columns, subsequent_indent='  ', break_long_words=False,
                         break_on_hyphens=False)


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Return a phrase that offers the valid names near to `name`; '' if none is near."""
    close = difflib.get_close_matches(name[:80], list(valid), n=3, cutoff=0.5)
    return offered(close)


def offered(names: Iterable[str]) -> str:
    """Return a phrase that offers the first three names; '' if there is none."""
    first = list(names)[:3]
    return 'did you mean ' + ' or '.join(first) + '?' if first else ''


def full_names(name: str, names: Iterable[str]) -> list[str]:
    """Return the dotted names that end as `name` does, or else nearly so: what was left out."""
    count = name.count('.') + 1
    ends: dict[str, list[str]] = {}
    for full in names:
        ends.setdefault('.'.join(full.split('.')[-count:]), []).append(full)
    if name in ends:
        return ends[name]
    close = difflib.get_close_matches(name[:80], ends, n=3, cutoff=0.75)
    return [full for end in close for full in ends[end]]


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return a phrase that offers the valid names nearest to `name`, or all of them."""
    names = sorted(set(valid))
    return did_you_mean(name, names) or 'valid are ' + ', '.join(names)


INT64 = 2**63       # whole numbers are below it, as those of ROS parameters


class _Brief(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write numbers of more than 4300 digits.
        return repr(x) if abs(x) < INT64 else f'<whole number of {x.bit_length()} bits>'


_BRIEF = _Brief()
_BRIEF.maxstring = _BRIEF.maxother = 80
_BRIEF.maxlevel = 3


def brief(value: object) -> str:
    """Return a value as one short line, however large it is."""
    return _BRIEF.repr(value)


def check_argument(name: str, value: object, kind: type | tuple[type, ...], valid: str) -> None:
    """Raise ConfigError, which names an argument of a function, unless it is of a kind."""
    if not isinstance(value, kind):
        raise ConfigError(f'{name}: {brief(value)} is not valid; valid is {valid}')


def check_path(name: str, value: object) -> None:
    """Raise ConfigError unless an argument is a path."""
    check_argument(name, value, (str, os.PathLike), 'a path')
