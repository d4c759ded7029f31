"""From the mechanics of a foot on regolith to MuJoCo's contact parameters.

MuJoCo makes the force of a contact row from

    f = (a_ref - a) / R,   a_ref = -b v - k r,   R = A (1 - d) / d

(MuJoCo documentation, Computation / Constraint model): r is the (negative) gap, v its rate, a its
acceleration, A the inverse mass that the model assigns to the body (`body_invweight0`), d the
impedance, which grows with depth from d0 to d1 as `solimp` says. So a contact point is a spring
k / R with a damper b / R and an added mass 1 / R = d / ((1 - d) A), that of the moving ground.
With `solref` = (-stiffness, -damping), k = stiffness d / d1^2 and b = damping / d1, hence

    stiffness = K A (1 - d0) d1^2 / d0^2,   damping = C A (1 - d0) d1 / d0

for K [N/m] and C [N s/m] at d = d0. Up to a depth of 0.7 tip radii d equals d0 within 1 %. From
there it grows steeply to d1 at one radius, where spring and damper are 196 and 99 times as stiff:
a tip must not penetrate deeper. Its centre would be below the surface, and MuJoCo, for which the
height field is a set of prisms, would push it sideways against their walls.

Tangentially there is no spring: inside the friction cone the point creeps with the damper
C `impratio`.

A tip that touches several facets of the ground has one contact point on each. Its spring is
stiffer by their number, and it penetrates less. A tip at the edge between two facets holds up to
2 deg beyond the friction angle.

Values. Friction: angle of internal friction of lunar soil 30 to 50 deg (Carrier, Olhoeft and
Mendell, Physical properties of the lunar surface, in: Lunar Sourcebook, 1991, ch. 9). Stiffness:
in the pressure-sinkage relation of undisturbed soil, pressure over sinkage is k_c / b + k_phi =
1.4 kN/m^2 / b + 820 kN/m^3 (ibid., from the Apollo rover), 1 MN/m^3 for a tip of b = 8 mm. The
Apollo 15 penetrometer measured 348 kPa at 16 cm, 2.2 MN/m^3 (Mitchell et al., Apollo soil
mechanics experiment S-200, 1974). On the 2.0 cm^2 of such a tip the first loading has 0.2 to
0.4 kN/m. Soil recovers only a part of its compression: unloading and reloading are several times
stiffer, which one linear spring cannot represent. The default of 2 kN/m is on the stiff side; with
the default damping the load of one foot is about critically damped.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.rover.physics.config import ContactConfig, LEAST_STEP_S

# Torques per normal force: about the normal, two thirds of the radius of the contact patch, and
# against rolling.
TORSIONAL_FRICTION_M, ROLLING_FRICTION_M = 0.004, 0.0005
IMPEDANCE = 0.5          # d0
BURIED_IMPEDANCE = 0.99  # d1
_MIDPOINT, _POWER = 0.95, 16.0   # growth between both: x^16 / 0.95^15 up to x = 0.95 radii


def set_contact(model: mujoco.MjModel, config: ContactConfig, geoms: np.ndarray,
                tip_radius_m: float) -> None:
    """Write the contact parameters into the given geoms of a compiled model.

    Raises:
        ConfigError: Where the model's time step cannot resolve the contact.
    """
    model.opt.impratio = config.shear_damping_nspm / config.damping_nspm
    d0, d1 = IMPEDANCE, BURIED_IMPEDANCE
    # The inverse mass of each geom's body.
    weights = model.body_invweight0[model.geom_bodyid[geoms], 0]
    check_step(model.opt.timestep, weights.max() * (1.0 - d0) / d0,
               ('contact.stiffness_npm', config.stiffness_npm, 1.0),
               ('contact.damping_nspm', config.damping_nspm, 1.0))
    k = config.stiffness_npm * weights * (1.0 - d0) / d0
    b = config.damping_nspm * weights * (1.0 - d0) / d0
    for geom, k_geom, b_geom in zip(geoms, k, b):
        model.geom_solref[geom] = -k_geom * d1 ** 2 / d0, -b_geom * d1
        model.geom_solimp[geom] = d0, d1, tip_radius_m, _MIDPOINT, _POWER
        model.geom_friction[geom] = (config.sliding_friction, TORSIONAL_FRICTION_M,
                                     ROLLING_FRICTION_M)


def check_step(step_s: float, mobility: float, stiffness: tuple[str, float, float],
               damping: tuple[str, float, float], with_what: str = '') -> None:
    """Check that a time step resolves the spring and the damper of a contact.

    With a step longer than 0.5 / sqrt(k) or 1 / b the feet chatter and lose their grip.

    Args:
        step_s: Time step [s].
        mobility: A (1 - d) / d of the lightest body, which has the fastest contact [1/kg].
        stiffness, damping: Name of the parameter, its value [N/m] or [N s/m], and by what it is
            multiplied in the contact.
        with_what: For the error, what else makes them what they are.

    Raises:
        ConfigError: Where the step is too long for one of them.
    """
    k, b = (mobility * value * factor for _, value, factor in (stiffness, damping))
    longest_s = {'N/m': 0.5 / k ** 0.5, 'N s/m': 1.0 / b}
    unit = min(longest_s, key=longest_s.__getitem__)
    if step_s <= longest_s[unit]:
        return
    (name, value, factor), most = {
        'N/m': (stiffness, 0.25 / (mobility * step_s ** 2)),
        'N s/m': (damping, 1.0 / (mobility * step_s))}[unit]
    shorter = (f', or step_s <= {_rounded_down(longest_s[unit])}'
               if longest_s[unit] >= LEAST_STEP_S else '')
    raise ConfigError(f'{name}: {value:g} is not valid with step_s = {step_s:g}{with_what}; valid '
                      f'is <= {_rounded_down(most / factor)} [{unit}] for the mass of this rover'
                      f'{shorter}')


def _rounded_down(value: float) -> str:
    """Return a positive number with two digits, none of which makes it larger."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f'{math.floor(value / digit) * digit:g}'
