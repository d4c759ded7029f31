"""Images with their rocks and craters as COCO and YOLO data sets.

They are of all cameras of a bag that have labels.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.base.files.paths import counted
from lunar_rover_sim.image.rendering.labels import CATEGORIES, Instance, instances, LEAST_PX
from lunar_rover_sim.products.sequences.sensors import RecordedCamera, SensorSuite
from lunar_rover_sim.products.sequences.sequence import PngWriter, Sequence


def run_lengths(instance: Instance, height: int, width: int) -> list[int]:
    """Return the run lengths of COCO: pixels outside and inside in turn, column by column.

    Args:
        height, width: Of the whole image [px].
    """
    padded = np.zeros((instance.mask.shape[0] + 2, instance.mask.shape[1]), np.int8)
    padded[1:-1] = instance.mask
    change = np.diff(padded, axis=0).T
    column, row = np.nonzero(change > 0)
    starts = (instance.x + column) * height + instance.y + row
    column, row = np.nonzero(change < 0)
    ends = (instance.x + column) * height + instance.y + row
    apart = starts[1:] != ends[:-1]     # a run may go on at the top of the next column
    starts = starts[np.concatenate([[True], apart])]
    ends = ends[np.concatenate([apart, [True]])]
    edges = np.concatenate([[0], np.column_stack([starts, ends]).ravel(), [height * width]])
    return [int(n) for n in np.diff(edges)]


def outline(instance: Instance) -> NDArray[np.int32]:
    """Return the (n, 2) pixels of an outline, x and y in the image: one closed polygon, n >= 3.

    Parts and holes are joined by paths that go forth and back, each where it is near to those
    before, so that a filled polygon, its outline included, covers the mask. A row of pixels goes
    forth and back, too.
    """
    contours, _ = cv2.findContours(instance.mask.astype(np.uint8), cv2.RETR_CCOMP,
                                   cv2.CHAIN_APPROX_SIMPLE)
    line, *parts = (contour[:, 0] for contour in contours)
    for part in parts:
        apart = cdist(line, part)
        i, j = divmod(int(apart.argmin()), len(part))
        line = np.concatenate([line[:i + 1], part[j:], part[:j + 1], line[i:]])
    if len(line) < 3:
        line = np.resize(line, (3, 2))
    return np.asarray(line + (instance.x, instance.y), np.int32)


def check_pinhole(suite: SensorSuite, what: str) -> None:
    """Raise SequenceError where images are distorted: labels are those of the pinhole image."""
    if any(suite.distortion):
        raise SequenceError(f'{what}: images with distortion {suite.distortion} do not fit the '
                            'labels, which are undistorted; valid is '
                            'render_node.camera.distortion: [0, 0, 0, 0, 0]')


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


_FILE = 'annotations/instances.json'


class CocoSequence(LabelledSequence):
    """Writes a COCO data set: images, annotations/instances.json with boxes and masks.

    The format of Lin et al. (Microsoft COCO: Common Objects in Context, ECCV 2014): boxes are x,
    y, width, height [px] of the upper left corner, masks uncompressed run lengths over the
    columns. `iscrowd` is 0. Beyond the format an image has `camera` and `stamp_ns`, an annotation
    the `number` of its rock or crater in the label image, and where the bag has the vocabulary
    `diameter_m` and the `age` of a crater. Annotations go to the file as they come.
    """

    layout = ('COCO: images, annotations/instances.json with boxes and masks of rocks and '
              'craters')

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._catalogues = catalogues(bag)
        self._images: list[dict[str, Any]] = []
        self._found = 0
        (folder / 'images').mkdir()
        categories = [{'id': k, 'name': name, 'supercategory': 'terrain'}
                      for k, name in enumerate(CATEGORIES, 1)]
        self.line(_FILE, f'{{"info": {{"description": {json.dumps(bag.path.name)}}}, '
                  f'"licenses": [], "categories": {json.dumps(categories)}, "annotations": [')

    def image(self, number: int, camera: str, stamp_ns: int, image: NDArray[Any],
              found: list[Instance]) -> None:
        """Write an image and its annotations."""
        height, width = image.shape[:2]
        name = f'{number:06d}.png'
        self.png.write(self.folder / 'images' / name, image)
        self._images.append({'id': number, 'file_name': name, 'width': width, 'height': height,
                             'camera': camera, 'stamp_ns': stamp_ns})
        for instance in found:
            self._found += 1
            text = json.dumps({
                'id': self._found, 'image_id': number,
                'category_id': 1 + CATEGORIES.index(instance.category), 'iscrowd': 0,
                'area': instance.area,
                'bbox': [instance.x, instance.y, *instance.mask.shape[::-1]],
                'segmentation': {'size': [height, width],
                                 'counts': run_lengths(instance, height, width)},
                'number': instance.number, **self._known(instance)})
            self.line(_FILE, ('' if self._found == 1 else ',') + text)

    def _known(self, instance: Instance) -> dict[str, float]:
        """Return what the vocabulary knows of an instance."""
        catalogue = self._catalogues.get(f'{instance.category}s', {})
        row = instance.number - int(catalogue.get('first_id', 0))
        if 'id' in catalogue:
            row = catalogue['id'].index(instance.number)
        return {name: catalogue[name][row] for name in ('diameter_m', 'age')
                if row < len(catalogue.get(name, ()))}

    def notes(self) -> list[str]:
        """Return how many annotations there are, and write the end of the file."""
        self.line(_FILE, f'], "images": {json.dumps(self._images)}}}')
        return [f'{counted(self._found, "annotation")}; what shows fewer than {LEAST_PX} pixels '
                'has none']


def catalogues(bag: Bag) -> dict[str, Any]:
    """Return the catalogues of rocks and craters of a bag, or nothing where it has none.

    Raises:
        SequenceError: Where its vocabulary is no JSON object.
    """
    if not bag.has(topics.LABEL_INFO.name):
        return {}
    try:
        found = json.loads(bag.first(topics.LABEL_INFO.name).data)
    except ValueError as error:
        raise SequenceError(f'{bag.path}: {topics.LABEL_INFO.name} is not valid JSON: '
                            f'{error}') from None
    kinds = {name: found.get(name) for name in ('rocks', 'craters')} \
        if isinstance(found, dict) else {}
    return {name: kind for name, kind in kinds.items() if isinstance(kind, dict)}


_DIGITS = 6


class YoloSequence(LabelledSequence):
    """Writes a YOLO data set: images, labels and boxes in text files, data.yaml.

    A line of `labels` is a class and the outline of an instance, x and y over width and height, as
    trainers of segmentation read it; trainers of detection that share their files make boxes of
    it. A line of `boxes` is a class and centre x, centre y, width and height, for those that do
    not.
    """

    layout = 'YOLO: images, labels (outlines of rocks and craters), boxes, data.yaml'

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._found = 0
        for name in ('images', 'labels', 'boxes'):
            (folder / name).mkdir()
        for text in ('path: .', 'train: images', 'val: images', 'names:',
                     *(f'  {k}: {name}' for k, name in enumerate(CATEGORIES))):
            self.line('data.yaml', text)

    def image(self, number: int, camera: str, stamp_ns: int, image: NDArray[Any],
              found: list[Instance]) -> None:
        """Write an image and a line for each instance."""
        height, width = image.shape[:2]
        name = f'{number:06d}'
        self.png.write(self.folder / 'images' / f'{name}.png', image)
        labels, boxes = [], []
        for instance in found:
            kind = CATEGORIES.index(instance.category)
            rows, columns = instance.mask.shape
            # Outlines go through the centres of pixels.
            corners = (outline(instance) + 0.5) / (width, height)
            labels.append(_line(kind, corners))
            boxes.append(_line(kind, [(instance.x + 0.5 * columns) / width,
                                      (instance.y + 0.5 * rows) / height,
                                      columns / width, rows / height]))
        for folder, lines in (('labels', labels), ('boxes', boxes)):
            (self.folder / folder / f'{name}.txt').write_text(''.join(lines), encoding='ascii')
        self.line('times.txt', f'{name} {stamp_ns} {camera}')
        self._found += len(labels)

    def notes(self) -> list[str]:
        """Return how many instances there are."""
        return [f'{counted(self._found, "instance")}; what shows fewer than {LEAST_PX} pixels '
                'is left out; train and val are the same images, split them by drive']


def _line(kind: int, values: Any) -> str:
    numbers = ' '.join(f'{value:.{_DIGITS}f}' for value in np.ravel(values))
    return f'{kind} {numbers}\n'
