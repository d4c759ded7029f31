"""OpenUSD's modules, which the extra `[usd]` installs.

All modules of this room import them from here, so that an import without the extra ends in one
line that says what to install. Commands import the room only when a stage is asked for.
"""

from __future__ import annotations

from lunar_rover_sim.errors import UsdError, with_extra

try:
    from pxr import (Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade,
                     UsdUtils, Vt)
except ImportError:
    raise UsdError(f"OpenUSD is missing; install it with: {with_extra('usd')} (Python 3.11 or "
                   'newer)') from None

__all__ = ['Gf', 'Kind', 'Sdf', 'Tf', 'Usd', 'UsdGeom', 'UsdLux', 'UsdPhysics', 'UsdSemantics',
           'UsdShade', 'UsdUtils', 'Vt']
