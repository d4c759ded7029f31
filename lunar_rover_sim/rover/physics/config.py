"""Parameters of the simulation: time step, gravity, start pose and contact."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.gravity import MOON_MPS2
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.ground.regolith.config import GroundConfig

LEAST_STEP_S = 1e-5
# At 1 ms and 0.25 m/s a walk of 20 s ends 0.1 % (discrete) or 1.7 % (implicitfast) from where it
# ends with steps of 0.1 ms.
INTEGRATORS = ('discrete', 'implicitfast', 'euler')


@dataclasses.dataclass(frozen=True)
class ContactConfig(Parameters):
    """The ground under a spoke tip: Coulomb friction and a spring-damper that stands for regolith.

    Each contact point pushes with stiffness times penetration plus damping times penetration rate,
    never pulls, and holds tangentially up to the friction cone. `contact.py` beside it gives the
    sources and the mapping to the parameters of the solver.
    """

    gone = {'torsional_friction_m': 0.004, 'rolling_friction_m': 0.0005}

    sliding_friction: float = param(
        0.8, 'tangent of the friction angle, 0.6 to 1.2 for lunar soil; not for feet on '
        'ground.model regolith', low=0.0, high=3.0, open_low=True)
    stiffness_npm: float = param(2000.0, 'normal force per penetration of one contact point',
                                 unit='N/m', low=1e-3, high=1e9)
    damping_nspm: float = param(60.0, 'normal force per penetration rate of one contact point',
                                unit='N s/m', low=1e-3, high=1e9)
    shear_damping_nspm: float = param(
        30000.0, 'tangential force per creep rate inside the friction cone', unit='N s/m',
        low=1e-3, high=1e12)


@dataclasses.dataclass(frozen=True)
class StartPose(Parameters):
    """Where the rover starts; height and tilt follow from the ground."""

    x_m: float = param(0.0, 'in the world frame', unit='m')
    y_m: float = param(0.0, 'in the world frame', unit='m')
    yaw_deg: float = param(0.0, 'from x (east) towards y (north)', unit='deg', low=-360.0,
                           high=360.0)
    joint_angle_rad: tuple[float, ...] = param((0.0,), 'one for all legs, or one for each',
                                               unit='rad', low=-5.0, high=5.0)
    settle_s: float = param(1.0, 'to come to rest before time 0', unit='s', low=0.0, high=60.0)


@dataclasses.dataclass(frozen=True)
class PhysicsConfig(Parameters):
    """The simulation; `step_s` is rounded to whole nanoseconds."""

    step_s: float = param(0.001, 'time step', unit='s', low=LEAST_STEP_S, high=0.005)
    gravity_mps2: float = param(MOON_MPS2, 'along -z: Moon 1.62, Earth 9.81',
                                unit='m/s^2', low=0.0, high=30.0)
    integrator: str = param('discrete', 'of MuJoCo', choices=INTEGRATORS)
    contact: ContactConfig = group(ContactConfig)
    ground: GroundConfig = group(GroundConfig)
    start: StartPose = group(StartPose)

    @property
    def step_ns(self) -> int:
        """Time step [ns]."""
        return round(self.step_s * 1e9)

    def without_effect(self) -> list[str]:
        """Return a sentence on each friction that is given and does not hold for the feet."""
        ground, contact, default = self.ground, self.contact, ContactConfig()
        if ground.deforms and contact.sliding_friction != default.sliding_friction:
            return ['contact.sliding_friction: holds for rocks and chassis; feet on regolith have'
                    ' ground.friction']
        return [f'ground.{name}: has no effect on rigid ground'
                for name in ground.given() if not ground.deforms]
