"""Hazard cameras of a bag: their topics, geometry and place on the rover."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import CameraCalibration, hazard_topics, read_calibration
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.hazard import HazardConfig, HazardRig
from lunar_rover_sim.run.recorded_run import RecordedRun

FISHEYE = 'equidistant'     # distortion_model of CameraInfo


@dataclasses.dataclass(frozen=True)
class RecordedCamera:
    """A hazard camera whose images and CameraInfo are in a bag.

    Attributes:
        name: As below `hazard/`, of one of a pair with /left or /right.
        topics: The contract's topics of hazard cameras → their names in the bag.
        calibration: Its CameraInfo.
        T_base_camera: (4, 4) optical frame in base_link.
    """

    name: str
    topics: Mapping[topics.Topic, str]
    calibration: CameraCalibration
    T_base_camera: Array

    @property
    def word(self) -> str:
        """The name as a part of file names."""
        return 'hazard_' + self.name.replace('/', '_')

    @property
    def is_fisheye(self) -> bool:
        """Whether it is a fisheye."""
        return self.calibration.distortion_model == FISHEYE

    @property
    def fits_truth(self) -> bool:
        """Whether its images have the geometry of its labels: no distorted pinhole."""
        return self.is_fisheye or not self.calibration.D.any()


def further_cameras(bag: Bag) -> list[RecordedCamera]:
    """Return the hazard cameras of a bag, in the order of their names.

    One without CameraInfo is left out.

    Raises:
        BagError: Where the bag does not say where a camera is on the rover.
    """
    return [RecordedCamera(name, names, read_calibration(bag, names[topics.HAZARD_INFO]),
                           _place(bag, name))
            for name, names in hazard_topics(bag).items()
            if {topics.HAZARD_IMAGE, topics.HAZARD_INFO} <= set(names)]


def _place(bag: Bag, name: str) -> Array:
    """Return T_base_camera (4, 4): from tf_static, else from the recorded scenario."""
    run = RecordedRun(bag)
    T = run.frame_from_tf(topics.hazard_frame(name))
    if T is not None:
        return T
    camera, _, side = name.partition('/')
    sets = run.scenario.get('render_node', 'hazard')
    if not isinstance(sets, Mapping) or camera not in sets:
        raise BagError(f'{bag.path}: neither tf_static nor the scenario says where the hazard '
                       f'camera {camera} is on the rover')
    try:
        rig = HazardRig(HazardConfig.from_mapping(sets[camera], f'render_node.hazard.{camera}'))
    except ConfigError as error:
        raise BagError(f'{bag.path}: its scenario is not of this version: {error}') from None
    return rig.T_base_right if side == 'right' else rig.T_base_left
