"""Files are untrusted: 300 mutated ones are valid, or one line says why they are not."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import copy
import functools
from pathlib import Path
import signal
import time
from typing import Any

import pytest
import yaml

from lunar_rover_sim.campaign.campaign_file import parse_campaign
from lunar_rover_sim.campaign.episode_plans import draw, episode
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.paths import config_folder
from lunar_rover_sim.run.scenario import Scenario

hypothesis = pytest.importorskip('hypothesis')
st = hypothesis.strategies

EXAMPLES = 100        # of each kind of file
LIMIT_CPU_S = 5.0     # a file of the largest size that is read at all takes this long
HANG_S = 120
SCENARIO = (config_folder() / 'scenarios' / 'baseline.yaml').read_text(encoding='utf-8')
CAMPAIGN = (config_folder() / 'campaigns' / 'polar_suns.yaml').read_text(encoding='utf-8')
RESOLVED = Scenario.load('baseline').to_yaml()

# What has broken parsers before: sizes, types, encodings, escapes, tags, bombs.
VALUES: list[Any] = [
    None, True, 0, -1, 2**31, 2**63, 2**64, -2**63, 10**400, 0.0, -0.0, 1e308, -1e308, 5e-324,
    float('nan'), float('inf'), '', 'x', '\x00', 'a\nb', '\U0001f311', 'x' * 5000, '../../etc',
    '/dev/zero', '/dev/full', '/', '~', '[]', [], {}, [[]], [None], [float('nan')], ['a'] * 500,
    {'a': {'b': {'c': 1}}}, {'uniform': [0, 1]}, {'choice': []}, {'choice': [{}]}, [1, 2, 3],
    {'choice': [{'a=b': 1}]}, {'uniform': [1, 0]}, {'uniform': [0, float('inf')]},
    {'normal': [0, 0]}, {'integer': [0, 10**18]}, {'log_uniform': [0, 1]},
    {'uniform': [0, 1], 'levels': 10**9}, {'choice': [[1], [2]]}, 'sobol', 'grid', 'lockstep']
KEYS: list[Any] = [
    '', '.', '..', 'a.b.c', 'x' * 3000, '\n', '\x07', '__class__', 'imu..preset', 'run', 'world',
    '/**', 'ros__parameters', 'vary', 'settings', 'episodes', 'base', 'name', '../x', 'seed', 7,
    None, True, 1.5, 'render_node.camera.width', 'render_node.camera', 'physics_node', 'a=b']
SNIPPETS = [
    '!!python/object/apply:os.system ["true"]', '!!binary aGk=', '!x y', '!!set {a}', '&a [*a]',
    '&a x', '*a', '<<: {a: 1}', '? [a]\n: b', '{' * 60, '[' * 5000, '- ' * 500, '%YAML 9.9\n---\n',
    '---\n---\n', '\x00', '\ufeff', '\t', '"', "'", ': ', '#', '0x' + 'f' * 400, '1' * 5000,
    '1:2:3', '2001-99-99', '1_0', '0o9', '.inf', '.nan', '|\n x', '>-\n x', '\\', '\u2028',
    'a: &a [x,x]\nb: &b [*a,*a]\nc: [*b,*b]\n']


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


@functools.cache
def document_of(text: str) -> Any:
    """Return what a valid file says; not to be changed."""
    return yaml.safe_load(text)


def mutated_values(draw_from: Any, text: str) -> Any:
    """Replace, add or rename a few entries anywhere in the document."""
    document = copy.deepcopy(document_of(text))
    for _ in range(draw_from(st.integers(1, 4))):
        node, way = document, draw_from(st.integers(0, 4))
        while isinstance(node, dict) and node and way:
            key = draw_from(st.sampled_from(list(node)))
            if not isinstance(node[key], dict) or not node[key]:
                break
            node, way = node[key], way - 1
        if not isinstance(node, dict):
            continue
        value = copy.deepcopy(draw_from(st.sampled_from(VALUES)))
        action = draw_from(st.integers(0, 3))
        if action < 2 and node:
            node[draw_from(st.sampled_from(list(node)))] = value
        elif action == 2:
            node[draw_from(st.sampled_from(KEYS))] = value
        elif node:
            key = draw_from(st.sampled_from(list(node)))
            node[draw_from(st.sampled_from(KEYS))] = node.pop(key)
    return document


def mutated_text(draw_from: Any, text: str) -> str:
    """Insert, cut, repeat or swap pieces of the text."""
    for _ in range(draw_from(st.integers(1, 4))):
        a = draw_from(st.integers(0, len(text)))
        b = draw_from(st.integers(a, min(len(text), a + 60)))
        piece = draw_from(st.one_of(st.sampled_from(SNIPPETS), st.text(max_size=12),
                                    st.just(text[a:b] * 3)))
        text = text[:a] + piece + text[b:]
    return text


@st.composite
def files(draw_from: Any, texts: list[str]) -> str:
    """Return a mutated file: half of them still well-formed YAML."""
    text = draw_from(st.sampled_from(texts))
    if draw_from(st.booleans()):
        return mutated_text(draw_from, text)
    document = mutated_values(draw_from, text)
    return str(yaml.safe_dump(document, allow_unicode=draw_from(st.booleans())))


def one_line(error: ConfigError) -> None:
    """A message for people: one line, not a page of it."""
    text = str(error)
    assert text and text.isprintable() and len(text) < 2000, text[:500]


def fuzz(strategy: Any) -> Any:
    """Return the decorator of a fuzz test."""
    settings = hypothesis.settings(max_examples=EXAMPLES, deadline=None, database=None,
                                   derandomize=True,
                                   suppress_health_check=list(hypothesis.HealthCheck))
    return lambda test: settings(hypothesis.given(strategy)(test))


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an empty folder."""
    return tmp_path_factory.mktemp('fuzz')


def test_scenarios(folder: Path) -> None:
    """A mutated scenario file gives a valid scenario, or one line that says why not."""
    path = folder / 'scenario.yaml'
    valid = 0

    @fuzz(files([SCENARIO, SCENARIO, SCENARIO, RESOLVED]))
    def check(text: str) -> None:
        nonlocal valid
        path.write_bytes(text.encode('utf-8', 'surrogatepass'))
        with limited():
            try:
                scenario = Scenario.load(str(path))
            except ConfigError as error:
                one_line(error)
                return
        assert isinstance(scenario, Scenario)
        valid += 1

    check()
    assert 0 < valid < EXAMPLES


def test_campaigns(folder: Path) -> None:
    """The same of campaign files, with their first episodes."""
    valid = 0

    @fuzz(files([CAMPAIGN]))
    def check(text: str) -> None:
        nonlocal valid
        with limited():
            try:
                campaign = parse_campaign(text, folder / 'campaign.yaml')
                drawn = draw(campaign)
                for k in {0, len(drawn) - 1} if drawn else ():
                    episode(campaign, f'{k:04d}', drawn[k])
            except ConfigError as error:
                one_line(error)
                return
        valid += 1

    check()
    assert 0 < valid < EXAMPLES


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
    ('world: {ros__parameters: {rocks: {max_number: 1000000000}}}', 'max_number'),
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
