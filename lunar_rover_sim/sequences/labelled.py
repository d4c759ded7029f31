"""Sequences of images with their rocks and craters: all cameras of a bag that have labels."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.rendering.instances import Instance, instances
from lunar_rover_sim.sequences.further import RecordedCamera
from lunar_rover_sim.sequences.instances import check_pinhole
from lunar_rover_sim.sequences.sequence import PngWriter, Sequence


@dataclasses.dataclass(frozen=True)
class LabelledCamera:
    """A camera with labels.

    Attributes:
        name: For users.
        image, labels, craters: Topics; craters may be missing in a bag.
    """

    name: str
    image: str
    labels: str
    craters: str


_LEFT = LabelledCamera('left', topics.LEFT_IMAGE.name, topics.LABELS.name, topics.CRATERS.name)
_RIGHT = LabelledCamera('right', topics.RIGHT_IMAGE.name, topics.RIGHT_LABELS.name,
                        topics.RIGHT_CRATERS.name)


class LabelledSequence(Sequence):
    """Numbers the images, and passes each with its instances to `image`.

    Attributes:
        count: Of the images so far.
    """

    of_further = (topics.HAZARD_IMAGE, topics.HAZARD_LABELS, topics.HAZARD_CRATERS)
    further_needs = ('they need camera_info and labels (ground_truth/hazard/NAME/labels) in the '
                     'bag, and a pinhole no distortion')
    needs: ClassVar[tuple[str, ...]] = (_LEFT.image, topics.LEFT_INFO.name, _LEFT.labels)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        check_pinhole(self.suite, str(bag.path))
        self.count = 0
        self._cameras = [_LEFT]
        # Images of the right camera without labels would be read for nothing.
        if bag.has(_RIGHT.image) and bag.has(_RIGHT.labels):
            self._cameras.append(_RIGHT)
        self.lacks = {_RIGHT.image: f'its images need {_RIGHT.labels} in the bag'}
        self.uses = tuple(name for camera in self._cameras
                          for name in (camera.image, camera.labels, camera.craters)
                          if name not in self.needs)

    def has_place_for(self, camera: RecordedCamera) -> bool:
        """Return whether it has labels that fit its images."""
        return topics.HAZARD_LABELS in camera.topics and camera.fits_truth

    def image(self, number: int, camera: str, stamp_ns: int, image: NDArray[Any],
              found: list[Instance]) -> None:
        """Write an image with what it shows."""
        raise NotImplementedError

    def images(self, stamp_ns: int, pixels: dict[str, NDArray[Any]]) -> None:
        """Take the images of a pair."""
        for camera in self._cameras:
            self._take(camera, stamp_ns, pixels)

    def further_images(self, camera: RecordedCamera, stamp_ns: int,
                       pixels: dict[str, NDArray[Any]]) -> None:
        """Take the images of a hazard camera."""
        image, labels, craters = (camera.topics.get(topic, '') for topic in self.of_further)
        self._take(LabelledCamera(camera.word, image, labels, craters), stamp_ns, pixels)

    def _take(self, camera: LabelledCamera, stamp_ns: int,
              pixels: dict[str, NDArray[Any]]) -> None:
        self.image(self.count, camera.name, stamp_ns, pixels[camera.image],
                   instances(pixels[camera.labels], pixels.get(camera.craters)))
        self.count += 1
