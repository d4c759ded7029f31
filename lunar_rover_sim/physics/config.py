"""Parameters of the simulation: time step, gravity, start pose, contact, and errors of the IMU."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import group, param, Parameters
from lunar_rover_sim.regolith.config import GroundConfig

# At 1 ms and 0.25 m/s a walk of 20 s ends 0.1 % (discrete) or 1.7 % (implicitfast) from where it
# ends with steps of 0.1 ms.
INTEGRATORS = ('discrete', 'implicitfast', 'euler')


@dataclasses.dataclass(frozen=True)
class ContactConfig(Parameters):
    """The ground under a spoke tip: Coulomb friction and a spring-damper that stands for regolith.

    Each contact point pushes with stiffness times penetration plus damping times penetration rate,
    never pulls, and holds tangentially up to the friction cone. `physics/contact.py` gives the
    sources and the mapping to the parameters of the solver.
    """

    sliding_friction: float = param(
        0.8, 'tangent of the friction angle, 0.6 (30 deg) to 1.2 (50 deg) for lunar soil; feet on'
        ' ground.model regolith have ground.friction instead', low=0.0, high=3.0, open_low=True)
    torsional_friction_m: float = param(
        0.004, 'torque about the normal per normal force: two thirds of the radius of the contact'
        ' patch', unit='m', low=0.0, open_low=True)
    rolling_friction_m: float = param(
        0.0005, 'torque against rolling per normal force', unit='m', low=0.0, open_low=True)
    stiffness_npm: float = param(2000.0, 'normal force per penetration of one contact point',
                                 unit='N/m', low=0.0, open_low=True)
    damping_nspm: float = param(60.0, 'normal force per penetration rate of one contact point',
                                unit='N s/m', low=0.0, open_low=True)
    shear_damping_nspm: float = param(
        30000.0, 'tangential force per creep rate inside the friction cone', unit='N s/m', low=0.0,
        open_low=True)


@dataclasses.dataclass(frozen=True)
class StartPose(Parameters):
    """Where the rover starts; height and tilt follow from the ground."""

    x_m: float = param(0.0, 'x in the world frame', unit='m')
    y_m: float = param(0.0, 'y in the world frame', unit='m')
    yaw_deg: float = param(0.0, 'heading, from x (east) towards y (north)', unit='deg')
    joint_angle_rad: tuple[float, ...] = param((0.0, 0.0, 0.0, 0.0), 'leg angles', unit='rad',
                                               length=4)
    settle_s: float = param(1.0, 'simulated time for the rover to come to rest before time 0',
                            unit='s', low=0.0, high=60.0)


@dataclasses.dataclass(frozen=True)
class PhysicsConfig(Parameters):
    """The simulation; `step_s` is rounded to whole nanoseconds."""

    step_s: float = param(0.001, 'time step', unit='s', low=1e-5, high=0.005)
    gravity_mps2: float = param(1.62, 'acceleration along -z: Moon 1.62, Earth 9.81', unit='m/s^2',
                                low=0.0, high=30.0)
    integrator: str = param('discrete', 'numerical integration in MuJoCo',
                            choices=INTEGRATORS)
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


FROM_PRESET = -1.0


@dataclasses.dataclass(frozen=True)
class ImuConfig(Parameters):
    """Errors of the IMU; densities and random walks in continuous-time units.

    The four noise parameters come from the preset unless they are given (>= 0). `physics/imu.py`
    holds the presets and their sources. With `enabled` false the true signal is published.
    """

    enabled: bool = param(True, 'false publishes the true signal')
    preset: str = param('adis16448', 'IMU model whose noise parameters are used',
                        choices=('none', 'adis16448', 'bmi160'))
    accel_noise_density: float = param(
        FROM_PRESET, 'white noise of the accelerometer; -1: from the preset',
        unit='m/s^2/sqrt(Hz)', low=-1.0)
    gyro_noise_density: float = param(
        FROM_PRESET, 'white noise of the gyroscope; -1: from the preset', unit='rad/s/sqrt(Hz)',
        low=-1.0)
    accel_bias_random_walk: float = param(
        FROM_PRESET, 'random walk of the accelerometer bias; -1: from the preset',
        unit='m/s^3/sqrt(Hz)', low=-1.0)
    gyro_bias_random_walk: float = param(
        FROM_PRESET, 'random walk of the gyroscope bias; -1: from the preset',
        unit='rad/s^2/sqrt(Hz)', low=-1.0)
    accel_initial_bias_mps2: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'bias of the accelerometer at time 0', unit='m/s^2', length=3)
    gyro_initial_bias_radps: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'bias of the gyroscope at time 0', unit='rad/s', length=3)
    accel_scale_error: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'relative error of the scale factor per axis', low=-0.5, high=0.5,
        length=3)
    gyro_scale_error: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'relative error of the scale factor per axis', low=-0.5, high=0.5,
        length=3)
    accel_misalignment_deg: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'rotation vector from imu_link to the true sensor axes', unit='deg',
        low=-20.0, high=20.0, length=3)
    gyro_misalignment_deg: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), 'rotation vector from imu_link to the true sensor axes', unit='deg',
        low=-20.0, high=20.0, length=3)
    accel_range_mps2: float = param(0.0, 'signal saturates at this magnitude; 0: unlimited',
                                    unit='m/s^2', low=0.0)
    gyro_range_radps: float = param(0.0, 'signal saturates at this magnitude; 0: unlimited',
                                    unit='rad/s', low=0.0)
    accel_resolution_mps2: float = param(0.0, 'step of quantisation; 0: none', unit='m/s^2',
                                         low=0.0)
    gyro_resolution_radps: float = param(0.0, 'step of quantisation; 0: none', unit='rad/s',
                                         low=0.0)

    def validate(self) -> None:
        """Raise ConfigError if a noise parameter is negative, other than -1 for the preset."""
        for name in ('accel_noise_density', 'gyro_noise_density', 'accel_bias_random_walk',
                     'gyro_bias_random_walk'):
            value = getattr(self, name)
            if value < 0.0 and value != FROM_PRESET:
                raise ConfigError(f'{name}: {value} is not valid; valid is >= 0, or -1 for the'
                                  f' value of the preset')


@dataclasses.dataclass(frozen=True)
class WheelOdometryConfig(Parameters):
    """Encoders of the legs, and what is known of the way that they do not see.

    Scales and deviations are those that `physics/wheel_odometry.py` holds of the ground unless
    they are given: rougher ground and another rover have others, which `lunar_rover_sim validate
    odometry` measures. The encoder's default is that of a Faulhaber IE2-512: 512 lines, four
    edges each, on the shaft of the motor.
    """

    counts_per_turn: int = param(2048, 'edges of the encoder per turn of the motor', low=1,
                                 high=2**20)
    forward_scale: float = param(FROM_PRESET, 'way of the rover over that of rolling feet, 0.1 to '
                                 '2; -1: that of the ground', low=-1.0, high=2.0)
    yaw_scale: float = param(FROM_PRESET, 'turn of the rover over that of rolling feet, 0.1 to 2; '
                             '-1: that of the ground', low=-1.0, high=2.0)
    forward_stddev: float = param(
        FROM_PRESET, 'error along the heading, for each root of a metre that the legs have rolled,'
        ' 0 to 10; -1: that of the ground', unit='m/sqrt(m)', low=-1.0, high=10.0)
    lateral_stddev: float = param(FROM_PRESET, 'error across the heading, likewise',
                                  unit='m/sqrt(m)', low=-1.0, high=10.0)
    yaw_stddev: float = param(FROM_PRESET, 'error of the heading, likewise', unit='rad/sqrt(m)',
                              low=-1.0, high=10.0)

    def validate(self) -> None:
        """Raise ConfigError if a value is neither possible nor -1."""
        for name, low, high in (('forward_scale', 0.1, 2.0), ('yaw_scale', 0.1, 2.0),
                                ('forward_stddev', 0.0, 10.0), ('lateral_stddev', 0.0, 10.0),
                                ('yaw_stddev', 0.0, 10.0)):
            value = getattr(self, name)
            if value != FROM_PRESET and not low <= value <= high:
                raise ConfigError(f'{name}: {value:g} is not valid; valid is {low:g} to {high:g},'
                                  ' or -1 for that of the ground')


@dataclasses.dataclass(frozen=True)
class PowerMonitorConfig(Parameters):
    """Monitors of voltage and current in the supply line of each motor and of all of them.

    The defaults are those of a Texas Instruments INA226 (data sheet SBOS547B, 2024, typical
    values, which are taken for standard deviations) with shunts of 20 mohm, for up to 4 A.
    """

    enabled: bool = param(True, 'false publishes the true values')
    shunt_ohm: float = param(0.02, 'shunt resistor', unit='ohm', low=0.0, open_low=True,
                             high=1000.0)
    shunt_range_v: float = param(0.08192, 'largest voltage over the shunt', unit='V', low=0.0,
                                 open_low=True, high=100.0)
    shunt_step_v: float = param(2.5e-6, 'step of that voltage', unit='V', low=0.0, high=1.0)
    shunt_offset_v: float = param(2.5e-6, 'standard deviation of its offset', unit='V', low=0.0,
                                  high=1.0)
    bus_step_v: float = param(1.25e-3, 'step of the supply voltage', unit='V', low=0.0, high=1.0)
    bus_offset_v: float = param(1.25e-3, 'standard deviation of its offset', unit='V', low=0.0,
                                high=1.0)
    gain_error: float = param(2e-4, 'standard deviation of the gain of each', low=0.0, high=0.5)
