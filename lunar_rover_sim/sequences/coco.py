"""COCO data sets: images, annotations/instances.json with boxes and masks of rocks and craters.

The format of Lin et al. (Microsoft COCO: Common Objects in Context, ECCV 2014): boxes are x, y,
width, height [px] of the upper left corner, masks uncompressed run lengths over the columns.
`iscrowd` is 0. Beyond the format an image has `camera` and `stamp_ns`, an annotation the `number`
of its rock or crater in the label image, and where the bag has the vocabulary `diameter_m` and the
`age` of a crater.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import SequenceError
from lunar_rover_sim.files.paths import counted
from lunar_rover_sim.rendering.instances import CATEGORIES, Instance, LEAST_PX
from lunar_rover_sim.sequences.instances import run_lengths
from lunar_rover_sim.sequences.labelled import LabelledSequence
from lunar_rover_sim.sequences.sequence import PngWriter

_FILE = 'annotations/instances.json'


class CocoSequence(LabelledSequence):
    """Writes a COCO data set; annotations go to the file as they come."""

    layout = ('COCO: images, annotations/instances.json with boxes and masks of rocks and '
              'craters')
    left_images = ('images',)

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
