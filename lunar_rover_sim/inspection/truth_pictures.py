"""Pictures of the truth that a bag holds beside its images: labels, craters, shadow, flow."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.rendering import layer_pictures

_TOPICS = (topics.LABELS, topics.CRATERS, topics.SHADOW, topics.NORMALS, topics.OPTICAL_FLOW,
           topics.SCENE_FLOW)


def truth_figure(bag: Bag, save: Callable[[Figure, str], None]) -> None:
    """Draw what is there of the last frame that has all of it."""
    wanted = [topic for topic in _TOPICS if bag.has(topic.name)]
    stamps = series.common_stamps(bag, [topic.name for topic in wanted])
    if not stamps:
        return
    names = {bag.resolve(topic.name): topic for topic in wanted}
    figure = Figure(figsize=(10, 5.2), layout='constrained')
    panels = figure.subplots(2, 3).flat
    for axes in panels:
        axes.set_axis_off()
    for axes, (name, _, message) in zip(figure.axes, bag.messages(names, stamps[-1],
                                                                  stamps[-1] + 1)):
        axes.set_title(names[name].name, fontsize=9)
        pixels = series.picture(bag, message).pixels
        axes.imshow(truth_picture(names[name], pixels)[..., ::-1])
    figure.suptitle(f'{stamps[-1] * 1e-9:.3f} s', fontsize=9)
    save(figure, 'truth.png')


def truth_picture(topic: topics.Topic, pixels: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return (h, w, 3) BGR colours of an image of one of these topics."""
    if topic is topics.LABELS:
        return layer_pictures.label_picture(np.asarray(pixels, np.int32))
    if topic is topics.CRATERS:
        return layer_pictures.crater_picture(np.asarray(pixels, np.int32))
    if topic is topics.SHADOW:
        return layer_pictures.shadow_picture(np.asarray(pixels, np.uint8))
    if topic is topics.NORMALS:
        return layer_pictures.normal_picture(np.asarray(pixels, np.float32))
    return layer_pictures.flow_picture(np.asarray(pixels, np.float32))
