"""The place on a map from orbit: found from 50 m of doubt, and not found where it is not."""

import dataclasses

from judge.slam import closed_way, relief_walk
import numpy as np
import pytest

from lunar_rover_sim.base.errors import LunarRoverSimError, SlamError
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.judge.slam.graph import pose_graph
from lunar_rover_sim.judge.slam.graph.anchor import Anchor, Doubt, FIXED, LOOKING, LOST

pytestmark = pytest.mark.skipif(not pose_graph.has_gtsam(), reason='gtsam is not installed')

NEAR = np.array([20.0, -25.0])      # of the start at the origin: 32 m


def walked(orbital, length_m=75.0, seed=0, **options):
    """Return anchor and walk from the origin, of a rover that is believed to be at NEAR."""
    anchor = Anchor(orbital, Doubt(tuple(NEAR), 50.0))
    return anchor, relief_walk.walk(anchor, np.zeros(2), 0.7 + seed, length_m, seed, **options)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_it_finds_its_place_and_says_so(seed):
    """Until then the doubt is told; then the error is within what is told."""
    anchor, found = walked(relief_walk.orbital(0), 100.0, seed=seed)
    first = next(k for k, news in enumerate(found.news) if 'is found' in news)
    assert min(found.sigmas_m[:first]) > 20.0
    errors = np.linalg.norm(np.array(found.errors_m)[first:, :2], axis=1)
    assert (errors < 4.0 * np.array(found.sigmas_m)[first:]).all()
    assert np.median(errors) < 1.5 and max(found.sigmas_m[first:]) < 3.0
    assert (anchor.fixes, anchor.losses, anchor.refused) == (1, 0, 0)
    assert anchor.place == FIXED
    # No estimate moves by a metre without a word.
    leaps = np.linalg.norm(np.diff(np.array(found.errors_m)[:, :2], axis=0), axis=1)
    assert all(found.news[k + 1] for k in np.flatnonzero(leaps > 1.0))


def changed(name):
    """Return a map that is not that of the ground."""
    good = relief_walk.orbital(0)
    heights = good.heights_m
    return {'of another site': relief_walk.orbital(7),
            'upside down': dataclasses.replace(good, heights_m=heights[::-1].copy()),
            'heights negated': dataclasses.replace(good, heights_m=-heights),
            'shifted by 100 m': dataclasses.replace(good, first_m=(good.first_m[0] + 100.0,
                                                                   good.first_m[1])),
            'in kilometres': dataclasses.replace(good, heights_m=heights / 1e3),
            'in millimetres': dataclasses.replace(good, heights_m=heights * 1e3),
            'in feet': dataclasses.replace(good, heights_m=heights / 0.3048)}[name]


@pytest.mark.parametrize('name', ['of another site', 'upside down', 'heights negated',
                                  'shifted by 100 m', 'in kilometres', 'in millimetres',
                                  'in feet'])
def test_on_a_wrong_map_no_place_is_found(name):
    """The doubt stays, and what does not fit is counted."""
    anchor, found = walked(changed(name))
    assert anchor.place == LOOKING and anchor.fixes == 0 and not any(found.news)
    assert min(found.sigmas_m) > 20.0
    assert anchor.looks > 5
    assert name != 'in millimetres' or anchor.refused == anchor.looks


def test_where_the_map_ceases_to_fit_the_place_is_lost_and_the_covariance_grows():
    """From 80 m on the rover sees other ground."""
    anchor, found = walked(relief_walk.orbital(0), 175.0,
                           ground_of=lambda way_m: 0 if way_m < 80.0 else 5)
    lost = [k for k, news in enumerate(found.news) if 'lost on the map' in news]
    assert anchor.fixes == 1 and anchor.losses == len(lost) == 1
    assert found.sigmas_m[lost[0] - 1] < 3.0 < 20.0 < found.sigmas_m[lost[0]]
    assert anchor.refused + anchor.contradicted >= 3
    assert 'lost 1 times' in anchor.words and anchor.place == LOST


def test_what_cannot_be_used_is_one_line(tmp_path):
    good = relief_walk.orbital(0)
    with pytest.raises(SlamError, match=r'near: \(500, 0\) m is not on the map from orbit'):
        Anchor(good, Doubt((500.0, 0.0), 50.0))
    with pytest.raises(SlamError, match='doubt: 0 m around'):
        Doubt((0.0, 0.0), 0.0)
    with pytest.raises(SlamError, match='doubt: 100 m is not valid; valid is at most 60.2 .m. on'):
        Anchor(good, Doubt((0.0, 0.0), 100.0))
    good.save(tmp_path / 'map')
    for words, said in (
            (['--near', '0,0'], '--near: needs --orbital'),
            (['--orbital', str(tmp_path / 'map')], '--orbital: is for --system graph'),
            (['--orbital', str(tmp_path / 'map'), '--system', 'graph'],
             '--orbital: needs --near'),
            (['--orbital', str(tmp_path / 'none'), '--near', '0,0', '--system', 'graph'],
             'no such file')):
        with pytest.raises(LunarRoverSimError, match=said):
            execute(['slam', 'run', str(tmp_path), '-o', str(tmp_path / 'out'), *words])


def test_a_bag_on_flat_ground_finds_nothing_and_says_so(tmp_path, capsys):
    """Its poses are those in the site; without sun and stars the map is not used."""
    steps = closed_way.drive(laps=0.3, heading=True)
    blind = [dataclasses.replace(step, aids=dataclasses.replace(step.aids, sun=None, stars=None))
             for step in steps]
    relief_walk.orbital(0).save(tmp_path / 'map')
    for name, drive, said in (('seen', steps, '0 fixes'), ('blind', blind, 'not used')):
        bag = closed_way.write(tmp_path / name, drive)
        assert execute(['slam', 'run', str(bag), '--system', 'graph', '-o',
                        str(tmp_path / f'out_{name}'), '--orbital', str(tmp_path / 'map'),
                        '--near', '3,4']) == 0
        told = ' '.join(capsys.readouterr().out.split())
        assert said in told and 'the estimate is lost on the site' in told
        assert (tmp_path / f'out_{name}' / 'live_covariance.txt').exists()
