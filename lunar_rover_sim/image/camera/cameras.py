"""The cameras of a rover are one list: the stereo pair first, then hazard and chase cameras.

An entry says what a camera is made of, where it is, and what is published of it. Publisher,
renderer, recording and checks know no other kinds: a colour camera is an entry whose sensor has
another encoding, a camera at the back an entry with another place. Every command imports it with
the parameters: geometry and lenses, which import SciPy, stand elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses

import numpy as np

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import Topic
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.image.camera.config import FurtherCameraConfig
from lunar_rover_sim.image.camera.hazard import fixed_frames, HazardConfig, HazardMount, sides
from lunar_rover_sim.image.camera.mount import Mount

_BOTH = ('left', 'right')
# Topic → the layers of the renderer that it shows or is computed from. CameraInfos come last:
# they tell that the images of the frame are out.
_OF_STEREO: dict[Topic, tuple[str, ...]] = {
    topics.EXPOSURE: ('left',),
    topics.LEFT_IMAGE: ('left',), topics.RIGHT_IMAGE: ('right',), topics.TRUE_DEPTH: ('depth',),
    topics.LEFT_COMPRESSED: ('left',), topics.RIGHT_COMPRESSED: ('right',),
    topics.DISPARITY: _BOTH, topics.DEPTH: _BOTH, topics.POINTS: _BOTH, topics.DEPTH_INFO: (),
    topics.LABELS: ('label',), topics.CRATERS: ('crater',), topics.SHADOW: ('shadow',),
    topics.NORMALS: ('normal',), topics.OPTICAL_FLOW: ('optical_flow',),
    topics.SCENE_FLOW: ('scene_flow',),
    **{topic: (layer,) for topic, layer in zip(topics.OF_RIGHT, (
        'right_depth', 'right_label', 'right_crater', 'right_shadow', 'right_normal'))},
    topics.NORMALS_COLOUR: ('normal',), topics.RIGHT_NORMALS_COLOUR: ('right_normal',),
    topics.FLOW_COLOUR: ('optical_flow',), topics.SCENE_FLOW_COLOUR: ('scene_flow',),
    topics.BOXES: ('label', 'crater'), topics.LEFT_INFO: (), topics.RIGHT_INFO: ()}
# Published of every frame, read or not: time may wait for them.
_ALWAYS = topics.LEFT_INFO, topics.RIGHT_INFO
# Layers of the topics of a hazard camera, left and right, in the order of `topics.OF_HAZARD`.
_OF_HAZARD: tuple[tuple[tuple[str, ...], ...], ...] = (
    (('left',), (), ('label',), ('crater',), ('depth',)),
    (('right',), (), ('right_label',), ('right_crater',), ('right_depth',)))


@dataclasses.dataclass(frozen=True)
class Output:
    """A topic of a camera.

    Attributes:
        topic: Its row of the contract.
        layers: Names of `rendering.frame`: what it shows or is computed from.
        period_ns: It is due in the first frame of each of these periods [ns].
        side: 0 of the left camera or the only one, 1 of the right one.
        always: Whether it is published without readers, too.
    """

    topic: Topic
    layers: tuple[str, ...]
    period_ns: int
    side: int = 0
    always: bool = False


@dataclasses.dataclass(frozen=True)
class CameraEntry:
    """A camera, or a pair of equal ones.

    Attributes:
        name: Section of its parameters in render_node, such as `hazard.front`; '' of the pair.
        config: Geometry, lens and sensor.
        outputs: Its topics, in the order in which they are published.
        rate_hz: Images per second [Hz].
        baseline_m: Between left and right camera [m]; None where the rover's description says it.
        frames: (parent, child, (4, 4) T_parent_child) of frames that only this list knows.
        mount: World and azimuth of the sun [deg] → what carries it; None where the rover's
            description says it.
        stream: Number of its noise, added to the seed; None: one that follows from its name.
    """

    name: str
    config: FurtherCameraConfig
    outputs: tuple[Output, ...]
    rate_hz: float
    baseline_m: float | None = 0.0
    frames: tuple[tuple[str, str, Array], ...] = ()
    mount: Callable[[World, float], Mount] | None = None
    stream: int | None = None

    @property
    def images(self) -> dict[str, str]:
        """Part of a file name, such as `hazard_rear_left` → layer, of what it takes."""
        return {output.topic.name.removesuffix('/image_raw').replace('/', '_'): output.layers[0]
                for output in self.outputs if output.topic.name.endswith('/image_raw')}

    def noise_seed(self, seed: int) -> int:
        """Return the seed of its noise, which does not depend on which camera is read first.

        Args:
            seed: Of the scenario.
        """
        if self.stream is not None:
            return seed + self.stream
        name = self.name.rpartition('.')[2]
        return int(np.random.SeedSequence([seed, *name.encode()]).generate_state(1)[0]) >> 1


def stereo_pair(config: FurtherCameraConfig, rate_hz: float, depth_every: int) -> CameraEntry:
    """Return the entry of the stereo pair; depth_every: frames from one with depth to the next."""
    period_ns = round(NS_PER_S / rate_hz)
    outputs = tuple(
        Output(topic, layers, period_ns * (depth_every if topic.rate == topics.DEPTH_FRAME else 1),
               side=int(topic is topics.RIGHT_INFO), always=topic in _ALWAYS)
        for topic, layers in _OF_STEREO.items())
    return CameraEntry('', config, outputs, rate_hz, None, stream=0)


def hazard_camera(name: str, config: HazardConfig) -> CameraEntry:
    """Return the entry of a hazard camera, or of a pair."""
    period_ns = NS_PER_S // config.rate_hz
    outputs = tuple(Output(topic, layers, period_ns, side)
                    for side, camera in enumerate(sides(name, config))
                    for topic, layers in zip(topics.hazard(camera), _OF_HAZARD[side]))
    return CameraEntry(f'hazard.{name}', config, outputs, config.rate_hz, config.stereo_baseline_m,
                       fixed_frames(name, config), lambda world, sun_deg: HazardMount(config))


def chase_camera(config: ChaseConfig) -> CameraEntry:
    """Return the entry of the chase camera. Its mount raises ConfigError for a bad tripod."""
    period_ns = NS_PER_S // config.rate_hz
    outputs = (Output(topics.CHASE_IMAGE, ('left',), period_ns),
               Output(topics.CHASE_INFO, (), period_ns), Output(topics.CHASE_POSE, (), period_ns))
    return CameraEntry('chase', config, outputs, config.rate_hz,
                       mount=lambda world, sun_deg: ChaseMount(config, sun_deg, world), stream=1)
