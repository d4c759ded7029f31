"""From the mechanics of a foot on regolith to MuJoCo's contact parameters.

MuJoCo makes the force of a contact row from

    f = (a_ref - a) / R,   a_ref = -b v - k r,   R = A (1 - d) / d

(MuJoCo documentation, Computation / Constraint model): r is the (negative) gap, v its rate, a its
acceleration, A the inverse mass that the model assigns to the body (`body_invweight0`), d the
impedance, which `solimp` lets grow with the depth from d0 to d1. So a contact point is a spring
k / R with a damper b / R and an added mass 1 / R = d / ((1 - d) A), the ground that moves along.
With `solref` = (-stiffness, -damping), k = stiffness d / d1^2 and b = damping / d1, hence

    stiffness = K A (1 - d0) d1^2 / d0^2,   damping = C A (1 - d0) d1 / d0

for K [N/m] and C [N s/m] at d = d0, which d is to 1 % up to 0.7 tip radii. From there on it
grows steeply to d1 at a whole radius, where spring and damper are 196 and 99 times as firm: a tip
must not sink deeper. Its middle would come below the surface, and the height field, which for
MuJoCo is a row of prisms, would hold it by their sides as if in a hole.

Tangentially there is no spring: inside the friction cone the point creeps with the damper
C `impratio`.

Where a tip touches several facets of the ground at once, each is a contact point of its own; the
spring is then as many times stiffer, and sinks less. A tip that rests against the edge between
two facets holds up to 2 deg beyond the friction angle.

Values. Friction: angle of internal friction of lunar soil 30 to 50 deg (Carrier, Olhoeft and
Mendell, Physical properties of the lunar surface, in: Lunar Sourcebook, 1991, ch. 9). Stiffness:
pressure over sinkage of undisturbed soil is k_c / b + k_phi = 1.4 kN/m^2 / b + 820 kN/m^3 (ibid.,
after the Apollo rover), 1 MN/m^3 for a tip of b = 8 mm; the Apollo 15 penetrometer met 348 kPa at
16 cm, 2.2 MN/m^3 (Mitchell et al., Apollo soil mechanics experiment S-200, 1974). On the 2.0 cm^2
of such a tip that is 0.2 to 0.4 kN/m to press it in for the first time. Soil does not spring back
so far: unloading and reloading are several times stiffer, and a spring cannot be both. The
default of 2 kN/m is on the firm side, and damps about critically what one foot carries.
"""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.physics.config import ContactConfig

IMPEDANCE = 0.5          # d0
BURIED_IMPEDANCE = 0.99  # d1
_MIDPOINT, _POWER = 0.95, 16.0   # how d grows between: x^16 / 0.95^15 up to 0.95 of a radius


def set_contact(model: mujoco.MjModel, config: ContactConfig, geoms: np.ndarray,
                tip_radius_m: float) -> None:
    """Write the contact parameters into the given geoms of a compiled model.

    Raises ConfigError where the model's time step cannot resolve the contact.
    """
    step = model.opt.timestep
    model.opt.impratio = config.shear_damping_nspm / config.damping_nspm
    d0, d1 = IMPEDANCE, BURIED_IMPEDANCE
    for geom in geoms:
        weight = model.body_invweight0[model.geom_bodyid[geom], 0]
        k = config.stiffness_npm * weight * (1.0 - d0) / d0
        b = config.damping_nspm * weight * (1.0 - d0) / d0
        # A step that is longer than half of 1 / sqrt(k), or than 1 / b, makes the feet chatter and
        # lose their hold.
        bound = min(0.5 / k ** 0.5, 1.0 / b)
        if step > bound:
            raise ConfigError(f'step_s: {step} is too long for a contact of'
                              f' {config.stiffness_npm:g} N/m and {config.damping_nspm:g} N s/m;'
                              f' valid is <= {bound:.2g} [s], or a softer contact')
        model.geom_solref[geom] = -k * d1 ** 2 / d0, -b * d1
        model.geom_solimp[geom] = d0, d1, tip_radius_m, _MIDPOINT, _POWER
        model.geom_friction[geom] = (config.sliding_friction, config.torsional_friction_m,
                                     config.rolling_friction_m)
