"""The locomotion study: the pitch that spoke legs cause, against that of a velocity interface.

The same velocity command is driven on perfectly flat ground through the gait and contact model,
and through a chassis that simply tracks it; the pitch of both is compared. Three claims are
tested, each by a number: legs start with a transient above their steady amplitude, their pitch has
the frequency of the steps, and a velocity interface shows neither.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim import frames
from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.prediction import prediction_miss, PredictionMiss
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.inertia import chassis_inertia
from lunar_rover_sim.studies.pitch import analyse, PitchCurve, PitchReport, STEADY_FROM_S
from lunar_rover_sim.studies.walking import flat_world, STATE_PERIOD_S, walk, Walk

SPEEDS_MPS = (0.06, 0.12, 0.2)
GRAVITIES_MPS2 = (1.62, 9.81)
FRAME_RATES_HZ = (10, 20, 40)
STAND_S = 1.0        # standing before the command
TRACKING_S = 0.1     # time constant with which the velocity interface tracks its command


@dataclasses.dataclass(frozen=True)
class LocomotionCase:
    """One speed under one gravity: both curves and their reports.

    cycle_hz, step_hz: gait cycles, and groups of legs that touch down, per second
    mean_speed_mps: of the walk in its steady part
    misses: how far a tracker would mispredict images of the walk, at FRAME_RATES_HZ
    """

    speed_mps: float
    gravity_mps2: float
    cycle_hz: float
    step_hz: float
    mean_speed_mps: float
    gait: PitchCurve
    interface: PitchCurve
    gait_report: PitchReport
    interface_report: PitchReport
    misses: tuple[PredictionMiss, ...]


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim, whether it holds in one case, and the number that shows it."""

    name: str
    text: str
    holds: bool
    value: float
    bound: str


def claims(case: LocomotionCase) -> list[Claim]:
    """Return the claims, tested on one case."""
    gait, interface = case.gait_report, case.interface_report
    ratio = gait.dominant_hz / case.step_hz
    smooth = interface.rms_deg / gait.rms_deg
    peak = interface.overshoot_deg / gait.steady_amplitude_deg
    return [
        Claim('start transient', 'steady amplitude and overshoot over the steady amplitude',
              gait.transient > 1.1, gait.transient, '> 1.1'),
        Claim('step frequency', 'dominant frequency of the pitch over the step frequency',
              abs(ratio - 1.0) < 0.1, ratio, '0.9 to 1.1'),
        Claim('smooth interface', 'RMS of the velocity interface over that of the gait',
              smooth < 1.0 / 3.0, smooth, '< 1/3'),
        Claim('no interface peak', 'overshoot of the velocity interface over the steady amplitude'
              ' of the gait', peak < 1.0 / 3.0, peak, '< 1/3'),
    ]


def study(calibration: GaitCalibration, rover: RoverDescription | None = None,
          physics: PhysicsConfig | None = None, gait: GaitConfig | None = None,
          speeds_mps: Sequence[float] = SPEEDS_MPS,
          gravities_mps2: Sequence[float] = GRAVITIES_MPS2, duration_s: float = 30.0,
          camera: CameraConfig | None = None,
          progress: Callable[[int, int], None] | None = None) -> list[LocomotionCase]:
    """Walk and track every speed under every gravity.

    duration_s: length of each walk, from the command on [s]
    progress: called after each case with the number of cases done, and of all
    """
    rover = rover or RoverDescription()
    gait = (gait or GaitConfig()).for_rover(rover)
    physics = physics or PhysicsConfig()
    rig = StereoRig(rover, camera or CameraConfig())
    ground, cases = flat_world(), []
    for gravity in gravities_mps2:
        settings = dataclasses.replace(physics, gravity_mps2=gravity, start=StartPose())
        with Simulation(ground, rover, settings) as simulation:
            for speed in speeds_mps:
                cases.append(_case(simulation, calibration, gait, speed, duration_s, rig))
                if progress is not None:
                    progress(len(cases), len(gravities_mps2) * len(speeds_mps))
    return cases


def velocity_interface(time_s: ArrayLike, speed_mps: float, command_s: float,
                       rover: RoverDescription, physics: PhysicsConfig) -> PitchCurve:
    """Return the pitch of a chassis that tracks a commanded speed on compliant support.

    The mass m of the rover rests on springs k and dampers c of the ground at the four feet, at
    +-x from its middle, and is pushed at the ground so that its speed tracks the command with a
    time constant; being h above the ground it pitches by

        J p'' = -m h v' - 4 x^2 (k p + c p'),    v' = (v_command - v) / tau,

    integrated by the semi-implicit Euler method at no more than 0.5 ms.
    """
    time = np.asarray(time_s, dtype=float)
    chassis, legs = rover.chassis, rover.legs
    mass = chassis.mass_kg + 4.0 * legs.mass_kg
    axles = np.array(rover.legs.axle_positions_m())
    inertia = (chassis_inertia(chassis)[1, 1] + chassis.mass_kg * chassis.com_m[0] ** 2
               + legs.mass_kg * np.sum(axles[:, 0] ** 2))
    height = (chassis.mass_kg * chassis.com_m[2] + legs.mass_kg * np.sum(axles[:, 2])) / mass
    height += legs.spoke_length_m - legs.axle_z_m
    lever = float(np.sum(axles[:, 0] ** 2))
    stiffness = lever * physics.contact.stiffness_npm
    damping = lever * physics.contact.damping_nspm
    interval = float(np.median(np.diff(time)))
    inner = max(1, math.ceil(interval / 0.0005))
    dt = interval / inner
    speed = pitch = rate = 0.0
    curve = np.empty(len(time))
    for i, now in enumerate(time):
        curve[i] = math.degrees(pitch)
        asked = speed_mps if now >= command_s else 0.0
        for _ in range(inner):
            acceleration = (asked - speed) / TRACKING_S
            moment = -mass * height * acceleration - stiffness * pitch - damping * rate
            speed += dt * acceleration
            rate += dt * moment / inertia
            pitch += dt * rate
    return PitchCurve('velocity interface', time, curve)


def _case(simulation: Simulation, calibration: GaitCalibration, gait: GaitConfig, speed: float,
          duration_s: float, rig: StereoRig) -> LocomotionCase:
    controller = GaitController(gait, calibration)

    def command(controller: GaitController, stamp_ns: int) -> None:
        controller.set_velocity(speed if stamp_ns * 1e-9 >= STAND_S else 0.0, 0.0, stamp_ns)

    done = walk(simulation, controller, STAND_S + duration_s, command)
    cycle_hz = controller.stride.phase_rate_hz
    step_hz = cycle_hz * len(set(gait.offsets))
    pitch = np.degrees(done.rpy_rad[:, 1])
    walked = PitchCurve('gait and contact', done.time_s, pitch)
    tracked = velocity_interface(done.time_s, speed, STAND_S, simulation.rover, simulation.config)
    steady_s = STAND_S + STEADY_FROM_S
    whole_s = math.floor((done.time_s[-1] - steady_s) * cycle_hz) / cycle_hz
    return LocomotionCase(
        speed, simulation.config.gravity_mps2, cycle_hz, step_hz,
        done.mean_velocity(steady_s, steady_s + whole_s)[0], walked, tracked,
        analyse(walked, STAND_S, cycle_hz, step_hz), analyse(tracked, STAND_S, cycle_hz, step_hz),
        tuple(_misses(done, rig, simulation.rover)))


def _misses(done: Walk, rig: StereoRig, rover: RoverDescription) -> Iterator[PredictionMiss]:
    """Yield how far constant velocity misses at each frame rate, from the command on."""
    T_world_base = np.array([
        frames.se3(frames.matrix_from_wxyz(frames.wxyz_from_rpy(*rpy)), position)
        for rpy, position in zip(done.rpy_rad, done.position_m)])
    first = int(np.searchsorted(done.time_s, STAND_S))
    for rate_hz in FRAME_RATES_HZ:
        every = round(1.0 / (rate_hz * STATE_PERIOD_S))
        miss = prediction_miss(T_world_base[first::every], rig, rover.standing_height_m, rate_hz)
        if miss is not None:
            yield miss
