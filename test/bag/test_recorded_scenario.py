"""The scenario that a recording holds: its sections, and what holds for all of them."""

import pytest

from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.errors import BagError

TEXT = """
/**: {ros__parameters: {seed: 7, use_sim_time: true, shared: {rate_hz: 5}}}
physics_node: {ros__parameters: {step_s: 0.001, imu: {preset: ideal}, seed: 9, shared: {x: 1}}}
render_node: {ros__parameters: null}
notes: {text: none of ours}
broken: {ros__parameters: 3}
"""


class OneMessage:
    """A bag with a scenario, or without."""

    def __init__(self, text, topic='scenario'):
        self.text, self.topic = text, topic

    def has(self, topic):
        return topic == self.topic

    def first(self, topic):
        assert topic == self.topic
        if self.text is None:
            raise BagError('damaged')
        return type('String', (), {'data': self.text})


def test_values_of_a_section_and_of_all():
    found = recorded_scenario(OneMessage(TEXT))
    assert found and set(found.sections) == {'/**', 'physics_node', 'render_node', 'notes'}
    assert found.get('physics_node', 'imu.preset') == 'ideal'
    # The section goes before what is shared; what it lacks is taken from there.
    assert found.get('physics_node', 'seed') == 9 and found.get('render_node', 'seed') == 7
    assert found.get('physics_node', 'shared.rate_hz') == 5
    assert found.get('no_node', 'seed') == 7
    assert found.get('physics_node', 'step_s.x') is None
    assert found.get('physics_node', 'absent', 'default') == 'default'


def test_numbers():
    found = recorded_scenario(OneMessage(TEXT))
    assert found.number('physics_node', 'step_s', 1.0) == 0.001
    assert isinstance(found.number('render_node', 'seed', 1.0), float)
    assert found.number('physics_node', 'imu.preset', 4.0) == 4.0       # text
    assert found.number('physics_node', 'use_sim_time', 4.0) == 4.0     # true is no number
    assert found.number('physics_node', 'absent', 4.0) == 4.0


@pytest.mark.parametrize('text', [None, '', '- a list', 'a: [', '# ' + 'x' * (1 << 20)])
def test_a_bag_without_a_scenario_has_an_empty_one(text):
    assert not recorded_scenario(OneMessage(text))
    assert recorded_scenario(OneMessage(TEXT), 'second').sections == RecordedScenario({}).sections


def test_a_scenario_may_be_long():
    """Some pages of it are read; more than a million characters are not."""
    text = TEXT + '# of no use' * 500
    assert recorded_scenario(OneMessage(text)).get('/**', 'seed') == 7
    assert not recorded_scenario(OneMessage(TEXT + '#' * (1 << 20)))


def test_of_several_rovers_each_has_its_own():
    bag = OneMessage(TEXT, 'second/scenario')
    assert recorded_scenario(bag, 'second').get('physics_node', 'seed') == 9
    assert not recorded_scenario(bag)
