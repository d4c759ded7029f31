"""Scenarios, campaigns and data sets are untrusted: what hurts is refused in one line."""

from collections.abc import Iterator
import contextlib
import json
from pathlib import Path
import signal
import time
from typing import Any

import pytest

from lunar_rover_sim.base.errors import brief, CampaignError, ConfigError, LunarRoverSimError
from lunar_rover_sim.base.files.yaml_text import parse_yaml
from lunar_rover_sim.campaign.campaign_file import draw, episode, parse_campaign
from lunar_rover_sim.campaign.card import make_card, write_card
from lunar_rover_sim.run.scenario import Scenario

LIMIT_CPU_S = 5.0     # a file of the largest size that is read at all takes this long
HANG_S = 120


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """End what hangs; bound the processor time of what does not."""
    def hang(*_: object) -> None:
        raise AssertionError(f'no answer within {HANG_S} s')

    before = signal.signal(signal.SIGALRM, hang)
    signal.alarm(HANG_S)
    start = time.process_time()
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert time.process_time() - start < LIMIT_CPU_S


def one_line(error: ConfigError) -> None:
    """A message for people: one line, not a page of it."""
    text = str(error)
    assert text and text.isprintable() and len(text) < 2000, text[:500]


BOMB = 'a: &a [x,x,x,x,x,x,x,x,x]\n' + ''.join(
    f'{n}: &{n} [{",".join(["*" + p] * 9)}]\n' for p, n in zip('abcdefgh', 'bcdefghi'))


@pytest.mark.parametrize(('text', 'match'), [
    (BOMB, 'anchors and aliases'),
    ('run: &a {ros__parameters: *a}', 'anchors and aliases'),
    ('run: !!python/object/apply:os.system ["touch /tmp/owned"]', 'tags'),
    ('run: !!set {ros__parameters}', 'tags'),
    ('[' * 100_000, 'nested deeper'),
    ('{a: ' * 10_000, 'nested deeper'),
    ('#' * 300_000, 'larger than'),
    ('world: {ros__parameters: {size_m: 1e9}}', 'size_m'),
    ('world: {ros__parameters: {size_m: 1000.0, cell_m: 0.001}}', 'size_m'),
    ('world: {ros__parameters: {surroundings: {samples: 1000000}}}', 'samples'),
    ('world: {ros__parameters: {rocks: {max_per_m2: 1000000000.0}}}', 'max_per_m2'),
    ('render_node: {ros__parameters: {camera: {width: 1000000}}}', 'width'),
    ('/**: {ros__parameters: {rover: /dev/zero}}', '/dev/zero'),
    ('/**: {ros__parameters: {seed: 0x' + 'f' * 5000 + '}}', 'seed'),
    ('run: {ros__parameters: {duration_s: 1' + '0' * 400 + '}}', 'duration_s'),
])
def test_hostile_files(text: str, match: str, tmp_path: Path) -> None:
    """What is meant to hurt is refused before it costs time or memory."""
    path = tmp_path / 'scenario.yaml'
    path.write_text(text)
    with limited(), pytest.raises(ConfigError, match=match) as caught:
        Scenario.load(str(path))
    one_line(caught.value)


@pytest.mark.parametrize(('line', 'match'), [
    ('name: ../../etc', 'name'),
    ('name: /tmp/x', 'name'),
    ('episodes: 100000000', 'episodes'),
    ('design: grid\nvary: {a.b: {uniform: [0, 1], levels: 1000}, c.d: {uniform: [0, 1], '
     'levels: 1000}}', 'more than'),
    ('formats: [../x]', 'formats'),
    ('base: /dev/zero.yaml', 'base|no such'),
    ('settings: {recorder_node.nothing: 1}', 'nothing'),
])
def test_hostile_campaigns(line: str, match: str, tmp_path: Path) -> None:
    """Names stay inside of the output folder; sizes are bounded before anything is made."""
    text = f'episodes: 1\n{line}' if not line.startswith('episodes') else line
    with limited(), pytest.raises(ConfigError, match=match) as caught:
        campaign = parse_campaign(text, tmp_path / 'campaign.yaml')
        for k, drawn in enumerate(draw(campaign)):
            episode(campaign, str(k), drawn)
    one_line(caught.value)


def test_a_scenario_cannot_name_where_a_campaign_writes(tmp_path: Path) -> None:
    """World and rover of the base scenario are those of its author's machine, outputs are refused.
    """
    campaign = parse_campaign('episodes: 1\nsettings: {world: /etc}', tmp_path / 'campaign.yaml')
    assert '/etc' not in episode(campaign, '0', draw(campaign)[0]).scenario_yaml
    for name in ('recorder_node.output', 'recorder_node.scenario_file'):
        campaign = parse_campaign(f'episodes: 1\nsettings: {{{name}: /etc/x}}',
                                  tmp_path / 'campaign.yaml')
        with pytest.raises(ConfigError, match="'/etc/x' is not valid in a run, which places the"):
            episode(campaign, '0', draw(campaign)[0])


def dataset(folder: Path, campaign: Any = None, **statistics: Any) -> Path:
    """Write a data set of one episode with a broken picture."""
    episode = folder / 'episodes' / '0000'
    (episode / 'kitti' / 'image_0').mkdir(parents=True)
    (episode / 'kitti' / 'image_0' / '000000.png').write_bytes(b'\x89PNG\r\n\x1a\nbroken')
    (episode / 'manifest.json').write_text(json.dumps({'statistics': statistics}))
    (folder / 'campaign.json').write_text(json.dumps({'campaign': campaign or {}}))
    return folder


@pytest.mark.parametrize(('campaign', 'words'), [
    ({'formats': [{}]}, 'formats: .* is not a list of names'),
    ({'formats': 3}, 'formats: 3 is not a list of names'), ({'vary': [1]}, 'vary: .* mapping'),
    ({'name': float('nan')}, 'card.json: cannot be written')])
def test_campaigns(tmp_path, campaign, words):
    with pytest.raises(CampaignError, match=words):
        write_card(dataset(tmp_path, campaign))


def test_numbers(tmp_path, capfd):
    """Numbers beyond all bounds are left out."""
    folder = dataset(tmp_path, duration_s=10**400, sgm_density=float('inf'), distance_m=2.0)
    card = make_card(folder)
    assert list(card['statistics']) == ['distance_m']
    assert capfd.readouterr().err == ''


@pytest.mark.parametrize(('manifest', 'words'), [
    ('{"statistics": {}, "drawn": 3}', 'drawn is not a mapping'),
    (Path('/dev/zero'), 'not a regular file')])
def test_manifests(tmp_path, manifest, words):
    path = dataset(tmp_path) / 'episodes' / '0000' / 'manifest.json'
    path.unlink()
    if isinstance(manifest, Path):
        path.symlink_to(manifest)
    else:
        path.write_text(manifest)
    with pytest.raises(CampaignError, match=words):
        make_card(tmp_path)


@pytest.mark.parametrize(('message', 'shown'), [
    ('a: 3 is not valid; valid is >= 5 [µm²]', 'a: 3 is not valid; valid is >= 5 [µm²]'),
    ('two\nlines\x1b[31m', 'two\\nlines\\x1b[31m'),
    ('x' * 5000, 'x' * 1500 + ' ...')])
def test_messages_are_one_line(message: str, shown: str) -> None:
    """Control characters are written out, long ones cut."""
    assert str(LunarRoverSimError(message)) == shown


def test_values_are_shown_briefly() -> None:
    """Neither size nor depth nor digits of a value make a message long or slow."""
    deep: list[object] = []
    for _ in range(25):
        deep = [deep, deep]     # 2^25 elements, were it written out
    for value in (deep, 'x' * 10**6, 10**5000, list(range(10**5)), {'k': deep}):
        assert len(brief(value)) < 300
    assert brief([1, 2.5, 'a']) == "[1, 2.5, 'a']"


def test_a_key_twice_is_refused() -> None:
    """At any depth."""
    for text in ('a: 1\na: 2', 'x: [{a: 1, a: 1}]', 'x: {y: {"a": 1, a: 2}}'):
        with pytest.raises(ConfigError, match="'a' is given twice"):
            parse_yaml(text, 'x.yaml')


def test_plain_yaml_is_read() -> None:
    """What people write is read as before: exponents without a point are numbers."""
    assert parse_yaml('a: [1e-3, 1.0e6, 2.5, 1e3x, x, true, null]\nb: {c: "d"}', 'x') == {
        'a': [1e-3, 1e6, 2.5, '1e3x', 'x', True, None], 'b': {'c': 'd'}}
