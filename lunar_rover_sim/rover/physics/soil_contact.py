"""The model of soft ground in MuJoCo: for each spoke tip a small plane of its own, that can sink.

MuJoCo's contact of tip and plane is the elastic part of the soil. `regolith/law.py` moves the
plane, which is the plastic part. Tips no longer touch the height field; they touch rocks as
before. The chassis touches rocks as a box, and the ground with balls along its bottom and at its
upper corners: a box that hangs low over a height field costs as much as the rest of a step, also
where it touches nothing, since MuJoCo looks at each prism below it.

With an impedance d the row f = (-b v - k r - a) / R, R = A (1 - d) / d, of a contact (see
`contact.py`) is a spring K and a damper C for `solref` = (-K A (1 - d), -C A (1 - d)). It
carries the mass 1 / R, which the law lets grow with the elastic depth: one that is there at once
makes the force jump by its weight where a tip touches. Mass that joins a tip on its way brings
energy: with 0.18, a fall is up to 3 % deeper than that of its own energy. Less would need a
shorter step on Earth.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.ground.regolith.soil import IMPEDANCE, PARKED_M, Soil
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import CHASSIS_GEOM, GROUND_BIT, ROCK_BIT, ROVER_PRIORITY, tip_geom
from lunar_rover_sim.rover.physics.contact import (check_step, ROLLING_FRICTION_M,
                                                   TORSIONAL_FRICTION_M)

# Of the chassis. A ball whose centre is in the ground is pushed sideways, as in `contact.py`. Its
# contact becomes nearly rigid one tip radius deep, well before that.
BALL_RADIUS_M, BALL_SPACING_M = 0.014, 0.1


@dataclasses.dataclass(frozen=True)
class SoilRows:
    """Where the soil of each tip is in the model, in the order of legs and spokes.

    Attributes:
        first_tip, tips: Geoms of the tips are first_tip, first_tip + 2, ... in MuJoCo's order.
        solref: (n, 2) parameters of the pairs while the soil holds.
    """

    first_tip: int
    tips: int
    mocap: tuple[int, ...]
    pairs: tuple[int, ...]
    solref: np.ndarray


def add_soil(spec: mujoco.MjSpec, rover: RoverDescription) -> None:
    """Give each tip of a rover's model a plane, which only this tip touches.

    Its chassis gets balls that touch the ground, without friction against rolling and twisting,
    since several of them touch at once.
    """
    _add_balls(spec)
    for leg in rover.legs.names:
        for spoke in range(rover.legs.spokes):
            tip = tip_geom(leg, spoke)
            spec.geom(tip).conaffinity = ROCK_BIT
            body = spec.worldbody.add_body(name=_soil(tip), mocap=True, pos=[0.0, 0.0, PARKED_M])
            body.add_geom(name=_soil(tip), type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.1, 0.1, 0.1],
                          contype=0, conaffinity=0)
            spec.add_pair(name=_soil(tip), geomname1=tip, geomname2=_soil(tip), condim=6)


def _add_balls(spec: mujoco.MjSpec) -> None:
    box = spec.geom(CHASSIS_GEOM)
    box.conaffinity = ROCK_BIT
    half = np.array(box.size)
    radius = min(BALL_RADIUS_M, *half)
    counts = np.ceil(2.0 * half[:2] / BALL_SPACING_M).astype(int) + 1
    x, y = (np.linspace(-1.0, 1.0, count) for count in counts)
    places = [(a, b, -1.0) for a in x for b in y]
    places += [(a, b, 1.0) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    for k, place in enumerate(places):
        box.parent.add_geom(
            name=f'{CHASSIS_GEOM}_ball_{k}', type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0.0, 0.0], pos=np.array(place) * (half - radius), contype=0,
            conaffinity=GROUND_BIT, condim=3, priority=ROVER_PRIORITY, group=1)


def set_soil(model: mujoco.MjModel, rover: RoverDescription, ground: GroundConfig,
             soil: Soil) -> SoilRows:
    """Write elasticity and friction of a soil into a compiled model with `add_soil`.

    Args:
        ground: Its parameters.
        soil: What gravity makes of them.

    Raises:
        ConfigError: Where the model's time step cannot resolve them.
    """
    names = [tip_geom(leg, spoke)
             for leg in rover.legs.names for spoke in range(rover.legs.spokes)]
    tips = [_id(model, mujoco.mjtObj.mjOBJ_GEOM, name) for name in names]
    pairs = [_id(model, mujoco.mjtObj.mjOBJ_PAIR, _soil(name)) for name in names]
    bodies = [_id(model, mujoco.mjtObj.mjOBJ_BODY, _soil(name)) for name in names]
    if tips != list(range(tips[0], tips[0] + 2 * len(tips), 2)):
        raise ConfigError('the geoms of the tips do not follow each other in the model')
    weights = model.body_invweight0[model.geom_bodyid[tips], 0]
    k = soil.elastic_npm * weights * (1.0 - IMPEDANCE)
    b = soil.damping_nspm * weights * (1.0 - IMPEDANCE)
    own = ground.unscaled_soil
    stiffness, damping = ((f'ground.{name}', getattr(own, name),
                           getattr(soil, name) / getattr(own, name))
                          for name in ('elastic_npm', 'damping_nspm'))
    check_step(model.opt.timestep, weights.max() * (1.0 - IMPEDANCE) / IMPEDANCE, stiffness,
               damping, f' and gravity_mps2 = {soil.gravity_mps2:g}')
    held = np.stack([-k, -b], axis=-1)
    for row, pair in enumerate(pairs):
        model.pair_dim[pair] = 6
        model.pair_solref[pair] = held[row]
        # Shear keeps its damping while the soil yields.
        model.pair_solreffriction[pair] = held[row]
        model.pair_solimp[pair] = IMPEDANCE, IMPEDANCE, rover.legs.tip_radius_m, 0.5, 2.0
        model.pair_friction[pair] = (soil.friction, soil.friction, TORSIONAL_FRICTION_M,
                                     ROLLING_FRICTION_M, ROLLING_FRICTION_M)
    return SoilRows(tips[0], len(tips), tuple(int(model.body_mocapid[body]) for body in bodies),
                    tuple(pairs), held)


def _soil(tip: str) -> str:
    return f'soil_{tip}'


def _id(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    return int(mujoco.mj_name2id(model, kind, name))
