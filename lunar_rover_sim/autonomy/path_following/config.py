"""Parameters of path following: what to drive, and when to stop."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters

MODES = ('none', 'profile', 'waypoints', 'spline')
SHAPES = ('none', 'circle', 'square', 'figure_eight', 'out_and_back', 'tour')


@dataclasses.dataclass(frozen=True)
class DriveConfig(Parameters):
    """What is driven: a timed list of velocities, a route, or nothing."""

    gone = {'profile_ramp': False, 'stuck_distance_m': 0.1}

    mode: str = param('none', 'profile: timed velocities; waypoints: straight from one to the '
                      'next; spline: a smooth curve through them', choices=MODES)
    start_delay_s: float = param(1.0, 'time at rest before the drive starts', unit='s', low=0.0)
    profile_times_s: tuple[float, ...] = param(
        (0.0,), 'start of each velocity, from the start of the drive; the last one holds',
        unit='s', low=0.0)
    profile_forward_mps: tuple[float, ...] = param((0.1,), 'of mode profile',
                                                   unit='m/s', low=-2.0, high=2.0)
    profile_yaw_rate_radps: tuple[float, ...] = param(
        (0.0,), 'of mode profile, left positive', unit='rad/s', low=-3.0, high=3.0)
    shape: str = param('none', 'route in place of the waypoints; it starts at the first pose '
                       'along its heading', choices=SHAPES)
    shape_size_m: float = param(4.0, 'diameter of the circle or of a loop, side of the square, or'
                                ' length of the way out', unit='m', low=0.0, open_low=True)
    waypoints_x_m: tuple[float, ...] = param((), 'of the waypoints', unit='m')
    waypoints_y_m: tuple[float, ...] = param((), 'of the waypoints', unit='m')
    relative: bool = param(False, 'waypoints are in the frame of the first pose instead of odom')
    laps: int = param(1, 'more than 1 closes an open route', low=1)
    speed_mps: float = param(0.12, 'forward speed on a route', unit='m/s', low=0.0, open_low=True,
                             high=2.0)
    max_yaw_rate_radps: float = param(0.15, 'greatest yaw rate; the rover slows down in tighter'
                                      ' curves', unit='rad/s', low=0.0, open_low=True, high=3.0)
    lookahead_m: float = param(0.5, 'distance along the route to the point steered towards',
                               unit='m', low=0.0, open_low=True)
    turn_in_place_deg: float = param(75.0, 'heading error above which the rover turns in place',
                                     unit='deg', low=10.0, high=180.0)
    goal_tolerance_m: float = param(0.2, 'a route is complete at this distance from its end',
                                    unit='m', low=0.0, open_low=True)
    tilt_limit_deg: float = param(40.0, 'stop when the base tilts more', unit='deg',
                                  low=0.0, high=180.0, open_low=True)
    stuck_time_s: float = param(10.0, 'stop after so long without progress; 0: never',
                                unit='s', low=0.0)
    border_m: float = param(1.0, 'stop when closer to the edge of the world', unit='m', low=0.0)

    def validate(self) -> None:
        """Raise ConfigError if lists differ in length or a route has no points."""
        n = len(self.profile_times_s)
        for name in ('profile_forward_mps', 'profile_yaw_rate_radps'):
            if len(getattr(self, name)) != n:
                raise ConfigError(f'{name}: {len(getattr(self, name))} elements given; valid is'
                                  f' {n}, as many as profile_times_s')
        if self.mode == 'profile' and n == 0:
            raise ConfigError('profile_times_s: no elements given; valid is 1 or more')
        if any(b <= a for a, b in zip(self.profile_times_s, self.profile_times_s[1:])):
            raise ConfigError(f'profile_times_s: {list(self.profile_times_s)} is not valid; valid'
                              ' is strictly increasing [s]')
        points = len(self.waypoints_x_m)
        if len(self.waypoints_y_m) != points:
            raise ConfigError(f'waypoints_y_m: {len(self.waypoints_y_m)} elements given; valid is'
                              f' {points}, as many as waypoints_x_m')
        if self.mode in ('waypoints', 'spline') and self.shape == 'none' and points == 0:
            raise ConfigError(f'waypoints_x_m: no elements given; mode {self.mode} needs waypoints'
                              ' or a shape')
