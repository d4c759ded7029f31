"""Parameters of the simulation: step, gravity, start pose, and what the ground does to a foot."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.parameters import group, param, Parameters

INTEGRATORS = ('implicitfast', 'discrete', 'euler')


@dataclasses.dataclass(frozen=True)
class ContactConfig(Parameters):
    """The ground under a spoke tip: Coulomb friction and a spring-damper that stands for regolith.

    Each contact point pushes with stiffness times sinkage plus damping times sinkage rate, never
    pulls, and holds tangentially up to the friction cone. Sources and the mapping to the solver's
    parameters: `physics/contact.py`.
    """

    sliding_friction: float = param(
        0.8, 'tangent of the friction angle; regolith 0.6 (30 deg) to 1.2 (50 deg)', low=0.0,
        high=3.0, open_low=True)
    torsional_friction_m: float = param(
        0.004, 'torque about the normal per normal force: two thirds of the radius of the contact'
        ' patch', unit='m', low=0.0, open_low=True)
    rolling_friction_m: float = param(
        0.0005, 'torque against rolling per normal force', unit='m', low=0.0, open_low=True)
    stiffness_npm: float = param(2000.0, 'normal force per sinkage of one contact point',
                                 unit='N/m', low=0.0, open_low=True)
    damping_nspm: float = param(60.0, 'normal force per sinkage rate of one contact point',
                                unit='N s/m', low=0.0, open_low=True)
    shear_damping_nspm: float = param(
        30000.0, 'tangential force per creep rate inside the friction cone', unit='N s/m', low=0.0,
        open_low=True)


@dataclasses.dataclass(frozen=True)
class StartPose(Parameters):
    """Where the rover starts; height and tilt follow from the ground."""

    x_m: float = param(0.0, 'world frame', unit='m')
    y_m: float = param(0.0, 'world frame', unit='m')
    yaw_deg: float = param(0.0, 'heading, from x (east) towards y (north)', unit='deg')
    joint_angle_rad: tuple[float, ...] = param((0.0, 0.0, 0.0, 0.0), 'leg angles', unit='rad',
                                               length=4)
    settle_s: float = param(1.0, 'time the rover is given to come to rest before time 0',
                            unit='s', low=0.0, high=60.0)


@dataclasses.dataclass(frozen=True)
class PhysicsConfig(Parameters):
    """The simulation; `step_s` is made of whole nanoseconds."""

    step_s: float = param(0.001, 'time step', unit='s', low=1e-5, high=0.005)
    gravity_mps2: float = param(1.62, 'along -z; the Moon 1.62, the Earth 9.81', unit='m/s^2',
                                low=0.0, high=30.0)
    integrator: str = param('implicitfast', 'numerical integration in MuJoCo',
                            choices=INTEGRATORS)
    contact: ContactConfig = group(ContactConfig)
    start: StartPose = group(StartPose)

    @property
    def step_ns(self) -> int:
        """Time step [ns]."""
        return round(self.step_s * 1e9)
