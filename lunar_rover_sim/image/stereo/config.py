"""Parameters of the matcher; apart from it, since every node reads them and only one matches."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters


@dataclasses.dataclass(frozen=True)
class SgmConfig(Parameters):
    """Matching: search range, costs, and what is thrown away as doubtful."""

    gone = {'speckle_range_px': 2}

    mode: str = param('3way', 'paths of the aggregation: 3way 3, sgbm 5 (twice the time), hh4 4 '
                      '(3.5 times), hh 8 (4.5 times)',
                      choices=('sgbm', 'hh', 'hh4', '3way'))
    refinement: bool = param(True, 'refine each match to a fraction of a pixel by the brightness '
                             'around it')
    half_resolution: bool = param(True, 'match images of half the size, in 0.6 of the time; '
                                  'refine in the full ones')
    unexplained_percent: int = param(
        25, 'greatest difference of the detail around a pixel and its match, over the sum of '
        'both; 100 allows all', unit='%', low=0, high=100)
    min_disparity: int = param(0, 'of the farthest point looked for', unit='px',
                               low=-512, high=1024)
    num_disparities: int = param(128, 'search range; 128 reaches ground 0.36 m away with the '
                                 'default rig', unit='px', low=16, high=1024)
    block_size: int = param(7, 'side, odd', unit='px', low=1, high=31)
    p1: int = param(0, 'cost of a disparity step of 1; 0: 8 block_size^2', low=0, high=100000)
    p2: int = param(0, 'cost of a larger step; 0: 32 block_size^2', low=0, high=100000)
    pre_filter_cap: int = param(31, 'gradient at which matching costs are cut off', low=1,
                                high=63)
    uniqueness_percent: int = param(8, 'by how much the best match must beat the others',
                                    unit='%', low=0, high=100)
    left_right_max_px: int = param(1, 'allowed difference of left and right match; -1: any',
                                   unit='px', low=-1, high=64)
    speckle_window_px: int = param(60, 'smaller patches are thrown away; 0 keeps them',
                                   unit='px', low=0, high=10000)
    min_contrast: float = param(3.0, 'least standard deviation within a block that is trusted',
                                unit='of 255', low=0.0, high=64.0)
    dark_level: int = param(20, 'rows above the first with a brighter pixel are sky and not '
                            'matched; 0 matches all rows', unit='of 255', low=0, high=255)

    find_sky: bool = param(True, 'no disparity for the sky, the sun and its ghosts')

    def validate(self) -> None:
        """Check what OpenCV demands."""
        if self.num_disparities % 16:
            raise ConfigError(f'num_disparities: {self.num_disparities} is not valid; valid is a '
                              'multiple of 16')
        if self.block_size % 2 == 0:
            raise ConfigError(f'block_size: {self.block_size} is not valid; valid is an odd '
                              'number')
        if self.p2 and self.p2 <= self.p1:
            raise ConfigError(f'p2: {self.p2} is not valid; valid is > p1 ({self.p1}) or 0')
