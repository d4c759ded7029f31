"""The scenario of a recording, as the recorder wrote it into the bag."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any

import yaml

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.files.yaml_text import FAST_LOADER
from lunar_rover_sim.rover.description import Legs

_SHARED = '/**'
_KEY = 'ros__parameters'
_MAX_CHARACTERS = 1 << 20


@dataclasses.dataclass(frozen=True)
class RecordedScenario:
    """Sections of a scenario file, values as YAML gives them; empty where none was recorded."""

    sections: Mapping[str, Mapping[str, Any]]

    def __bool__(self) -> bool:
        return bool(self.sections)

    def get(self, section: str, name: str, default: Any = None) -> Any:
        """Return `section.name` (dotted names reach into groups), or the shared `/**` value."""
        for values in (self.sections.get(section, {}), self.sections.get(_SHARED, {})):
            value: Any = values
            for part in name.split('.'):
                value = value.get(part) if isinstance(value, Mapping) else None
            if value is not None:
                return value
        return default

    @property
    def legs(self) -> tuple[str, ...]:
        """The names of the rover's legs; those of the default rover where it names none."""
        each = self.get('rover', 'legs.each')
        return tuple(map(str, each)) if isinstance(each, Mapping) else Legs().names

    def number(self, section: str, name: str, default: float) -> float:
        """Return a number; the default where it is missing or not a number."""
        value = self.get(section, name)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
        return default


def recorded_scenario(bag: Bag, namespace: str | None = None) -> RecordedScenario:
    """Return the scenario in the bag; an empty one where there is none that can be read.

    Args:
        namespace: Of the rover, where the bag holds several.
    """
    topic = topics.SCENARIO.name if namespace is None else f'{namespace}/{topics.SCENARIO.name}'
    if not bag.has(topic):
        return RecordedScenario({})
    try:
        return scenario_of_text(str(bag.first(topic).data))
    except (BagError, AttributeError):
        return RecordedScenario({})


def scenario_of_text(text: str) -> RecordedScenario:
    """Return the scenario of a YAML text; an empty one where it cannot be read."""
    try:
        document = (yaml.load(text, FAST_LOADER) if len(text) <= _MAX_CHARACTERS  # noqa: S506
                    else None)
    except (yaml.YAMLError, RecursionError, ValueError):
        return RecordedScenario({})
    if not isinstance(document, Mapping):
        return RecordedScenario({})
    return RecordedScenario({
        str(name): body.get(_KEY) or {} for name, body in document.items()
        if isinstance(body, Mapping) and isinstance(body.get(_KEY), (Mapping, type(None)))})
