"""What the command line makes of its words, without running the command, and what it says."""

from typing import Any
from unittest import mock

from lunar_rover_sim.cli.main import execute


def given(*words: str) -> dict[str, Any]:
    """Return the arguments that a command would be called with, by name."""
    with mock.patch('click.Command.invoke', lambda command, context: context.params):
        found: Any = execute(words)
    return dict(found)


def unfolded(said: str) -> str:
    """Return errors that are folded to 100 columns, each on one line."""
    return said.replace('\n  ', ' ')
