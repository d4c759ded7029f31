"""The soils by name, and what of them depends on gravity.

Grains without cohesion bear in proportion to gravity: forces scale as rho g L^3 (Slonaker et al.,
General scaling relations for locomotion in granular media, Phys. Rev. E 95, 2017). So a soil names
the gravity at which its strength holds.

Sources. `highland`, `mare`: pressure over sinkage 1.0 MN/m^3 for a footing of 8 mm (Carrier,
Olhoeft and Mendell, Lunar Sourcebook, 1991, ch. 9), and Surveyor 3, whose footpads bore 20 to
60 kPa at 2 to 5 cm. `highland_dense`: the Apollo 15 penetrometer, 348 kPa at 16 cm (Mitchell et
al., S-200, 1974). `highland_loose`: a choice, for fresh ejecta and crater rims. They are measured
in place, so they contain the cohesion of the soil. Poppy seeds: Li, Zhang and Goldman 2013; their
friction and repose are choices, 35 and 36 deg. Friction of the lunar soils is a choice, too: 33 to
45 deg, within the 24 to 47 deg of boulder tracks (Boulder tracks and nature of lunar soil, 1973,
NTRS 19730039283); so are stiffness and damping of a tip, alike for all. How much of a print is
compacted, and the angle of repose of small heaps, are choices: loose soil is pressed together,
dense soil aside.
So is the way over which shear is mobilised, a tenth to a quarter of the width of a tip, as for
piles that are pushed sideways; the 1.8 cm of the Apollo rover (Lunar Sourcebook, ch. 9) belong to
its wheels of 23 cm.
"""

from __future__ import annotations

import dataclasses
import math

from lunar_rover_sim.base.gravity import EARTH_MPS2, MOON_MPS2
from lunar_rover_sim.ground.regolith.resistive_force import (GENERIC, POPPY_CLOSE, POPPY_LOOSE,
                                                             ResistiveForce)

IMPEDANCE = 0.18        # of MuJoCo's contact of a tip: `rover/physics/soil_contact.py` says why
PARKED_M = -1e4         # height of the plane of a tip that is in the air


@dataclasses.dataclass(frozen=True)
class Soil:
    """A soil under the gravity at which its numbers hold.

    Attributes:
        gravity_mps2: That gravity.
        zeta_npm3: Force per area and depth of a flat plate pressed down [N/m^3].
        friction: Tangent of the friction angle.
        cohesion_pa: Besides what zeta contains [Pa].
        compacted: Part of the volume of a print that goes into compaction; the rest into its rim.
        repose_deg: Steepest slope of disturbed soil.
        shear_m: Way over which shear is mobilised: 1 - exp(-way / shear_m) of it holds (Janosi and
            Hanamoto 1961) [m].
        elastic_npm: Unloading and reloading stiffness of one tip [N/m].
        damping_nspm: Damping of one tip while the soil does not yield [N s/m].
        shape: Coefficients of resistive force theory.
        weak_slopes: Whether slopes bear less than level ground.
    """

    gravity_mps2: float
    zeta_npm3: float
    friction: float
    cohesion_pa: float
    compacted: float
    repose_deg: float
    shear_m: float
    elastic_npm: float
    damping_nspm: float
    shape: ResistiveForce = GENERIC
    weak_slopes: bool = True

    def under(self, gravity_mps2: float) -> Soil:
        """Return the soil under another gravity.

        Strength and stiffness are in proportion to it, damping to its root, so that a walk at
        equal Froude number leaves the same prints. Cohesion stays.
        """
        ratio = gravity_mps2 / self.gravity_mps2
        return dataclasses.replace(
            self, gravity_mps2=gravity_mps2, zeta_npm3=self.zeta_npm3 * ratio,
            elastic_npm=self.elastic_npm * ratio,
            damping_nspm=self.damping_nspm * math.sqrt(ratio))

    @property
    def cohesive_bearing_pa(self) -> float:
        """Pressure that cohesion adds under a round footing on the surface [Pa].

        c N_c s_c with N_q = exp(pi tan phi) tan^2(45 deg + phi / 2), N_c = (N_q - 1) / tan phi
        (Prandtl 1921, Reissner 1924) and s_c = 1 + N_q / N_c (de Beer 1970).
        """
        if self.cohesion_pa == 0.0:
            return 0.0
        phi = math.atan(self.friction)
        n_q = math.exp(math.pi * self.friction) * math.tan(0.25 * math.pi + 0.5 * phi) ** 2
        n_c = (n_q - 1.0) / self.friction
        return self.cohesion_pa * (n_c + n_q)


PRESETS = {
    'highland_loose': Soil(MOON_MPS2, 0.3e6, 0.65, 0.0, 0.8, 33.0, 0.004, 2000.0, 60.0),
    'highland': Soil(MOON_MPS2, 1.0e6, 0.84, 0.0, 0.6, 38.0, 0.0025, 2000.0, 60.0),
    'highland_dense': Soil(MOON_MPS2, 2.2e6, 1.0, 0.0, 0.3, 42.0, 0.0015, 2000.0, 60.0),
    'mare': Soil(MOON_MPS2, 1.0e6, 0.84, 0.0, 0.6, 38.0, 0.0025, 2000.0, 60.0),
    'poppy_loose': Soil(EARTH_MPS2, 0.254e6, 0.70, 0.0, 0.3, 36.0, 0.004, 2000.0, 60.0,
                        POPPY_LOOSE),
    'poppy_close': Soil(EARTH_MPS2, 0.464e6, 0.70, 0.0, 0.1, 36.0, 0.0015, 2000.0, 60.0,
                        POPPY_CLOSE),
}
