"""What a data set holds, by the topics that were recorded and what is kept of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.sensors.registry import card_contents
from lunar_rover_sim.sequences.formats import FORMATS

IMAGES, STEREO, DEPTH, LABELS, IMU, LIDAR = (
    'images', 'stereo', 'depth', 'labels', 'imu', 'lidar')
# Each needs one topic of each of its groups.
_LEFT = topics.LEFT_IMAGE, topics.LEFT_COMPRESSED
_NEEDS: Mapping[str, tuple[tuple[topics.Topic, ...], ...]] = {
    IMAGES: (_LEFT,),
    STEREO: (_LEFT, (topics.RIGHT_IMAGE, topics.RIGHT_COMPRESSED)),
    DEPTH: ((topics.TRUE_DEPTH,),),
    LABELS: ((topics.LABELS,),),
    IMU: ((topics.IMU_RAW,),),
    LIDAR: (topics.OF_LIDAR,),
    **{content.name: (published,) for content, published in card_contents().items()}}
CONTENTS = tuple(_NEEDS)


def recorded_topics(bag: Bag) -> list[str]:
    """Return the topics of the contract of which a bag holds messages."""
    known = topics.of_legs(topics.CONTRACT, topics.legs_of(bag.types))
    return [topic.name for topic in known if bag.count(topic.name)]


def contents(recorded: Iterable[str], campaign: Mapping[str, Any]) -> list[str]:
    """Return those of CONTENTS that a data set holds.

    recorded: topics of the contract that were recorded; campaign: as in CAMPAIGN_FILE. Without
    bags, what its formats take of the topics counts.
    """
    # What each leg has counts by its name in the contract.
    held = {name if (of := topics.of_leg(name)) is None else of[0].name for name in recorded}
    if not campaign.get('keep_bag', True):
        taken: set[str] = set()
        for kind in campaign.get('formats', ()):
            if kind in FORMATS:
                made = FORMATS[kind]
                taken.update(made.needs, made.uses)
        held &= taken
    return [name for name in CONTENTS
            if all(any(topic.name in held for topic in group) for group in _NEEDS[name])]
