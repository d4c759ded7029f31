"""Costs by maps from orbit are made where one drives, and again where one drives elsewhere."""

from pathlib import Path

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation import from_orbit
from lunar_rover_sim.autonomy.navigation.config import GlobalPlanConfig
from lunar_rover_sim.autonomy.navigation.from_orbit import CostsFromOrbit
from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.ground.world.world_folder import save_world

RECIPE = {'size_m': 6.4, 'cell_m': 0.1, 'surroundings': {'samples': 257, 'extent_m': 200.0}}
SUN = 60.0, 6.0


@pytest.fixture(name='made')
def _made(monkeypatch: pytest.MonkeyPatch) -> list[OrbitalMap]:
    made: list[OrbitalMap] = []
    original = from_orbit.orbital_map

    def kept(*args, **values):
        made.append(original(*args, **values))
        return made[-1]

    monkeypatch.setattr(from_orbit, 'orbital_map', kept)
    return made


@pytest.fixture(name='world', scope='module')
def _world(tmp_path_factory: pytest.TempPathFactory) -> str:
    world = build_world(WorldConfig.from_mapping(RECIPE), 4)
    return str(save_world(world, tmp_path_factory.mktemp('maps') / 'world'))


def test_the_photo_is_of_where_one_drives(world: str, made: list[OrbitalMap]) -> None:
    costs = CostsFromOrbit(world, '', GlobalPlanConfig(), SUN)
    first = costs([(0.0, 0.0), (40.0, 20.0)])
    assert costs([(10.0, 10.0), (30.0, 5.0)]) is first and len(made) == 1
    assert made[0].photo.shape == (140, 160) and made[0].photo_first_m == (-59.5, -59.5)
    # The rover believes to be a little beside: the photo is there, too.
    assert costs([(12.0, -16.0), (40.0, 20.0)]) is first and len(made) == 1
    costs([(0.0, 0.0), (-70.0, 0.0)])
    assert len(made) == 2 and made[1].photo_first_m[0] == -129.5


@pytest.mark.parametrize('sun', [None, (60.0, 0.4)])
def test_without_sun_there_is_no_photo(sun: tuple[float, float] | None, world: str,
                                       made: list[OrbitalMap]) -> None:
    costs = CostsFromOrbit(world, '', GlobalPlanConfig(), sun)
    assert costs([(0.0, 0.0), (40.0, 20.0)]) is costs([(-90.0, 0.0)])
    assert len(made) == 1 and made[0].photo.size == 0


def test_given_maps_are_read_once(world: str, made: list[OrbitalMap], tmp_path: Path) -> None:
    CostsFromOrbit(world, '', GlobalPlanConfig(), SUN)([(0.0, 0.0), (40.0, 20.0)])
    made[0].save(tmp_path / 'maps')
    costs = CostsFromOrbit('', str(tmp_path / 'maps'), GlobalPlanConfig(), SUN)
    again = costs([(0.0, 0.0), (40.0, 20.0)])
    assert costs([(-90.0, 0.0)]) is again and len(made) == 1
    direct = CostsFromOrbit(world, '', GlobalPlanConfig(), SUN)([(0.0, 0.0), (40.0, 20.0)])
    assert np.isfinite(again.cost).any()
    # Places of craters in the file are rounded.
    assert np.isclose(again.cost, direct.cost, rtol=1e-3).mean() > 0.999


def test_maps_that_are_none_are_refused_at_once(tmp_path: Path) -> None:
    for text, said in ((None, 'no such file'), ('{"format": 1}', "'errors' is missing"),
                       ('{', 'is no JSON')):
        if text is not None:
            (tmp_path / 'orbital.json').write_text(text)
        with pytest.raises(WorldError, match=f'^maps: .*orbital.json: .*{said}'):
            CostsFromOrbit('', str(tmp_path), GlobalPlanConfig(), None)
