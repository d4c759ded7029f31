"""Pictures of the truth that a bag holds beside its images: labels, craters, shadow, flow."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.rendering import layer_pictures

_OF_LEFT = (topics.LABELS, topics.CRATERS, topics.SHADOW, topics.NORMALS, topics.OPTICAL_FLOW,
            topics.SCENE_FLOW)
_LEFT_OF = dict(zip(topics.OF_RIGHT, (topics.TRUE_DEPTH, topics.LABELS, topics.CRATERS,
                                      topics.SHADOW, topics.NORMALS), strict=True))


def truth_figures(bag: Bag, save: Callable[[Figure, str], None]) -> None:
    """Draw the truth of the last frame with all recorded layers, for each camera of the pair."""
    _figure(bag, _OF_LEFT, 'truth.png', save)
    _figure(bag, topics.OF_RIGHT, 'truth_right.png', save)


def _figure(bag: Bag, shown: Sequence[topics.Topic], file: str,
            save: Callable[[Figure, str], None]) -> None:
    wanted = [topic for topic in shown if bag.has(topic.name)]
    stamps = series.common_stamps(bag, [topic.name for topic in wanted])
    if not stamps:
        return
    names = {bag.resolve(topic.name): topic for topic in wanted}
    found = {names[name]: message for name, _, message in
             bag.messages(names, stamps[-1], stamps[-1] + 1)}
    figure = Figure(figsize=(10, 5.2), layout='constrained')
    panels = figure.subplots(2, 3).flat
    for axes in panels:
        axes.set_axis_off()
    for axes, topic in zip(figure.axes, (topic for topic in wanted if topic in found)):
        axes.set_title(topic.name, fontsize=9)
        pixels = series.picture(bag, found[topic]).pixels
        axes.imshow(truth_picture(_LEFT_OF.get(topic, topic), pixels)[..., ::-1])
    figure.suptitle(f'{stamps[-1] * 1e-9:.3f} s', fontsize=9)
    save(figure, file)


def truth_picture(topic: topics.Topic, pixels: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return (h, w, 3) BGR colours of an image of a topic of the left camera's truth."""
    if topic is topics.TRUE_DEPTH:
        return layer_pictures.depth_picture(np.asarray(pixels, np.float32))
    if topic is topics.LABELS:
        return layer_pictures.label_picture(np.asarray(pixels, np.int32))
    if topic is topics.CRATERS:
        return layer_pictures.crater_picture(np.asarray(pixels, np.int32))
    if topic is topics.SHADOW:
        return layer_pictures.shadow_picture(np.asarray(pixels, np.uint8))
    if topic is topics.NORMALS:
        return layer_pictures.normal_picture(np.asarray(pixels, np.float32))
    return layer_pictures.flow_picture(np.asarray(pixels, np.float32))
