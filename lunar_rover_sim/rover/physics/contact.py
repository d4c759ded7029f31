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

import mujoco
import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.rover.physics.config import ContactConfig

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
    step = model.opt.timestep
    model.opt.impratio = config.shear_damping_nspm / config.damping_nspm
    d0, d1 = IMPEDANCE, BURIED_IMPEDANCE
    # The inverse mass of each geom's body; the lightest body has the fastest contact.
    weights = model.body_invweight0[model.geom_bodyid[geoms], 0]
    k = config.stiffness_npm * weights * (1.0 - d0) / d0
    b = config.damping_nspm * weights * (1.0 - d0) / d0
    # With a step longer than 0.5 / sqrt(k) or 1 / b the feet chatter and lose their grip.
    bound = min(0.5 / k.max() ** 0.5, 1.0 / b.max())
    if step > bound:
        raise ConfigError(f'step_s: {step} is too long for a contact of'
                          f' {config.stiffness_npm:g} N/m and {config.damping_nspm:g} N s/m;'
                          f' valid is <= {bound:.2g} [s], or a softer contact')
    for geom, k_geom, b_geom in zip(geoms, k, b):
        model.geom_solref[geom] = -k_geom * d1 ** 2 / d0, -b_geom * d1
        model.geom_solimp[geom] = d0, d1, tip_radius_m, _MIDPOINT, _POWER
        model.geom_friction[geom] = (config.sliding_friction, TORSIONAL_FRICTION_M,
                                     ROLLING_FRICTION_M)
