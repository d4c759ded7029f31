"""Campaign files, designs, episodes: what is drawn, how it spreads, that it repeats."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import packaged_names
from lunar_rover_sim.campaign.campaign_file import (Campaign, Distribution, draw, episode,
                                                    episode_seed, LATIN_HYPERCUBE, load_campaign,
                                                    parse_campaign, plan, RANDOM, SOBOL,
                                                    unit_points)
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario


def parsed(text: str, folder: Path = Path('/nowhere')) -> Campaign:
    """Return the campaign of a text."""
    return parse_campaign(text, folder / 'test.yaml')


def test_latin_hypercube_meets_every_slice_once() -> None:
    """In each dimension there is one place in each of n slices."""
    cube = unit_points(LATIN_HYPERCUBE, 50, 4, seed=3)
    assert (np.sort(np.floor(cube * 50).astype(int), axis=0) == np.arange(50)[:, None]).all()


def test_sobol_is_balanced_and_goes_on() -> None:
    """Of 64 points each lies in another 64th; more episodes begin with the same ones."""
    cube = unit_points(SOBOL, 64, 5, seed=1)
    assert (np.sort(np.floor(cube * 64).astype(int), axis=0) == np.arange(64)[:, None]).all()
    assert unit_points(SOBOL, 40, 5, seed=1) == pytest.approx(cube[:40], abs=0.0)
    assert unit_points(SOBOL, 200, 5, seed=1)[:64] == pytest.approx(cube, abs=0.0)


@pytest.mark.parametrize('design', [LATIN_HYPERCUBE, SOBOL, RANDOM])
def test_designs_repeat(design: str) -> None:
    """The same seed gives the same points, another one others."""
    first = unit_points(design, 33, 3, seed=7)
    assert (first == unit_points(design, 33, 3, seed=7)).all()
    assert not np.allclose(first, unit_points(design, 33, 3, seed=8))
    assert first.min() >= 0.0
    assert first.max() < 1.0


@pytest.mark.parametrize(('text', 'low', 'high', 'mean'), [
    ({'uniform': [2.0, 4.0]}, 2.0, 4.0, 3.0),
    ({'log_uniform': [0.01, 1.0]}, 0.01, 1.0, 0.99 / np.log(100.0)),
    ({'normal': [5.0, 2.0]}, -1.0, 11.0, 5.0),
    ({'integer': [1, 4]}, 1, 4, 2.5),
    ({'choice': [1, 2, 6]}, 1, 6, 3.0)])
def test_distributions(text: dict[str, Any], low: float, high: float, mean: float) -> None:
    """Bounds hold at both ends; the mean over even probabilities is that of the distribution."""
    distribution = Distribution.parse('x', text)
    even = (np.arange(3000) + 0.5) / 3000
    values = np.array([distribution.quantile(float(u)) for u in even])
    assert low <= values.min() <= values.max() <= high
    assert values.mean() == pytest.approx(mean, rel=2e-3)
    assert low <= distribution.quantile(0.0) <= high
    assert low <= distribution.quantile(float(np.nextafter(1.0, 0.0))) <= high
    assert Distribution.parse('x', distribution.to_mapping()) == distribution


def test_normal_is_normal() -> None:
    """Quantiles are those of the theory, but for the cut at three sigma (0.27 %)."""
    distribution = Distribution.parse('x', {'normal': [0.0, 1.0]})
    for place, quantile in ((0.5, 0.0), (0.8413, 1.0), (0.1587, -1.0)):
        assert distribution.quantile(place) == pytest.approx(quantile, abs=5e-3)


def test_grid_takes_every_combination() -> None:
    """Ends included, in order, the last one fastest."""
    campaign = parsed('design: grid\nvary:\n  render_node.sun.elevation_deg: {uniform: [0, 10], '
                      'levels: 3}\n  physics_node.imu.preset: {choice: [adis16448, bmi160]}\n')
    drawn = draw(campaign)
    assert campaign.count == len(drawn) == 6
    assert [(d['render_node.sun.elevation_deg'], d['physics_node.imu.preset'])
            for d in drawn] == [(e, p) for e in (0.0, 5.0, 10.0) for p in ('adis16448', 'bmi160')]


def test_sun_is_low_where_nothing_is_said() -> None:
    """The elevation is uniform from 0 to 15 degrees; a campaign that names it has its own."""
    drawn = draw(parsed('episodes: 64'))
    elevations = sorted(d['render_node.sun.elevation_deg'] for d in drawn)
    assert elevations == pytest.approx((np.arange(64) + 0.5) * 15 / 64, abs=15 / 128)
    for text in ('settings: {render_node.sun.elevation_deg: 30.0}',
                 'vary: {s: {choice: [{render_node.sun.elevation_deg: 30.0}]}}'):
        assert draw(parsed(f'episodes: 2\n{text}'))[0].get(
            'render_node.sun.elevation_deg', 30.0) == 30.0
    # A date decides the elevation.
    dated = parsed("episodes: 2\nsettings: {render_node.sun.date: '2026-11-22'}")
    assert 'render_node.sun.elevation_deg' not in draw(dated)[0]


def test_seeds_are_all_different_and_repeat() -> None:
    """Each episode has a seed of its own, unless the campaign says so."""
    seeds = [d['seed'] for d in draw(parsed('episodes: 500'))]
    assert len(set(seeds)) == 500
    assert seeds == [episode_seed(1, k) for k in range(500)]
    assert 'seed' not in draw(parsed('episodes: 1\nsettings: {seed: 9}'))[0]


def test_an_episode_is_a_whole_scenario(tmp_path: Path) -> None:
    """Its file alone loads to the same scenario: resolved, with what was drawn, no paths."""
    campaign = parsed('episodes: 3\nsettings: {run.duration_s: 1.23}\nvary:\n'
                      '  render_node.sun.azimuth_deg: {uniform: [0, 90]}\n'
                      '  r: {choice: [{drive_node.shape: circle, drive_node.laps: 2}]}\n')
    for one in plan(campaign):
        path = tmp_path / 'scenario.yaml'
        path.write_text(one.scenario_yaml)
        scenario = Scenario.load(str(path))
        assert resolve(scenario).to_yaml() == one.scenario_yaml
        assert scenario.render_node.sun.azimuth_deg == one.drawn['render_node.sun.azimuth_deg']
        assert (scenario.drive_node.shape, scenario.drive_node.laps) == ('circle', 2)
        assert scenario.run.duration_s == one.duration_s == 1.25
        assert scenario.shared.seed == one.drawn['seed']


def test_the_base_may_lie_beside_the_campaign(tmp_path: Path) -> None:
    """A file name is looked for there, not where the command runs; its rover comes along."""
    (tmp_path / 'rover.yaml').write_text('chassis: {mass_kg: 3.0}\n')
    (tmp_path / 'mine.yaml').write_text(
        f'/**: {{ros__parameters: {{rover: {tmp_path}/rover.yaml}}}}\n'
        'run: {ros__parameters: {duration_s: 3.0}}\n')
    (tmp_path / 'campaign.yaml').write_text('base: mine.yaml\nepisodes: 1\n')
    first = next(plan(load_campaign(tmp_path / 'campaign.yaml')))
    document = yaml.safe_load(first.scenario_yaml)
    assert document['rover']['ros__parameters']['chassis']['mass_kg'] == 3.0
    assert str(tmp_path) not in first.scenario_yaml
    assert first.duration_s == 3.0


def test_packaged_campaigns_are_valid() -> None:
    """Their first and last episodes are valid scenarios."""
    names = packaged_names('campaign')
    assert names
    for name in names:
        campaign = load_campaign(name)
        assert campaign.config.description
        drawn = draw(campaign)
        assert len(drawn) == campaign.count > 0
        for k in (0, -1):
            assert episode(campaign, '0', drawn[k]).duration_s > 0.0


@pytest.mark.parametrize(('text', 'match'), [
    ('[]', 'not a campaign'),
    ('{}', 'episodes: 0 is not valid'),
    ('epsiodes: 3', 'did you mean episodes'),
    ('episodes: 1\ndesign: sobolev', 'did you mean sobol'),
    ('episodes: 1\nvary: {a: 3}', 'vary.a: 3 is not a distribution'),
    ('episodes: 1\nvary: {a: {unifrom: [0, 1]}}', 'did you mean uniform'),
    ('episodes: 1\nvary: {a: {uniform: [1, 0]}}', 'lower, then upper'),
    ('episodes: 1\nvary: {a: {uniform: [0, .inf]}}', 'finite'),
    ('episodes: 1\nvary: {a: {uniform: [0, 1], choice: [1]}}', '2 distributions'),
    ('episodes: 1\nvary: {a: {log_uniform: [0, 1]}}', 'valid is > 0'),
    ('design: grid\nvary: {a: {uniform: [0, 1]}}', 'a grid needs levels'),
    ('design: grid\nepisodes: 5\nvary: {a: {choice: [1, 2]}}', 'the grid has 2'),
    ('episodes: 1\nsettings: {a.b: 1}\nvary: {a.b: {choice: [1]}}', 'is in settings too'),
    ('episodes: 1\nkeep_bag: false', 'keep_bag'),
    ('episodes: 1\nname: a/b', 'name'),
    ('episodes: 1\nformats: [kity]', 'did you mean kitti'),
    ('episodes: 1\nvary: {render_node.sun.azimut_deg: {uniform: [0, 1]}}',
     'episode 0000: render_node.sun.azimut_deg: no such parameter; did you mean azimuth_deg'),
    ('episodes: 1\nvary: {render_node.sun.elevation_deg: {uniform: [100, 200]}}',
     'elevation_deg: .* is not valid'),
    ('episodes: 1\nbase: baselin', 'did you mean baseline')])
def test_mistakes_are_named(text: str, match: str) -> None:
    """One line that names the parameter and offers what is valid."""
    with pytest.raises(ConfigError, match=match) as caught:
        list(plan(parsed(text)))
    assert len(str(caught.value).splitlines()) == 1


def test_file_table_needs_a_file() -> None:
    """A campaign that is not there is named."""
    with pytest.raises(ConfigError, match='no_such.yaml: no such campaign file'):
        load_campaign('no_such.yaml')
    with pytest.raises(ConfigError, match='polar_sun: no such campaign; did you mean polar_suns'):
        load_campaign('polar_sun')


def test_a_dry_run_of_many_episodes_is_quick(tmp_path: Path, capsys) -> None:
    """All are named and drawn; the parameters of the first ones are checked."""
    path = tmp_path / 'many.yaml'
    path.write_text('base: flat\nepisodes: 2000\ndesign: random\n')
    assert main(['campaign', str(path), '--dry-run']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2001
    assert lines[-2].startswith('1999: render_node.sun.elevation_deg = ')
    assert lines[-1] == 'checked: the parameters of the first 100 of 2000 episodes'


def test_scenarios_vary() -> None:
    """`base` may be drawn: each episode has the parameters of its own scenario."""
    campaign = parsed("""
        episodes: 6
        vary: {base: {choice: [baseline, feature_sparse]}}
        """)
    episodes = list(plan(campaign))
    assert {e.drawn['base'] for e in episodes} == {'baseline', 'feature_sparse'}
    for found in episodes:
        own = Scenario.load(found.drawn['base'])
        values = yaml.safe_load(found.scenario_yaml)['world']['ros__parameters']
        assert values['rocks']['abundance'] == own.world.rocks.abundance
    with pytest.raises(ConfigError, match='episode 0000: base: 3 is not valid'):
        list(plan(parsed('episodes: 1\nsettings: {base: 3}')))
