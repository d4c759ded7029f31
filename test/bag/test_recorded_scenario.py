"""The scenario and the types that a recording holds."""

import re

import pytest
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat

from lunar_rover_sim.bag.reader import open_bag, typestore_of
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base.errors import BagError

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


def test_of_several_rovers_each_has_its_own():
    bag = OneMessage(TEXT, 'second/scenario')
    assert recorded_scenario(bag, 'second').get('physics_node', 'seed') == 9
    assert not recorded_scenario(bag)


def written(path, definition):
    """Return a bag of one message of four bytes, 1 2 3 4, of a type of this definition."""
    with BagWriter(path) as writer:
        writer.add_topic('/it', 'my_msgs/msg/It', definition=definition)
        writer.write('/it', 'my_msgs/msg/It', b'\0\1\0\0\1\2\3\4', 0)
    return path


def test_a_type_of_the_same_name_is_read_by_the_definition_of_its_bag(tmp_path):
    whole = written(tmp_path / 'whole', 'uint32 it\n')
    halves = written(tmp_path / 'halves', 'uint16 it\nuint16 rest\n')
    for _ in range(2):
        with open_bag(whole) as bag:
            assert bag.first('/it').it == 0x04030201
        with open_bag(halves) as bag:
            assert (bag.first('/it').it, bag.first('/it').rest) == (0x0201, 0x0403)


@pytest.mark.parametrize('others', [0, 8])
def test_equal_definitions_share_a_typestore_and_a_closed_bag_keeps_none(tmp_path, others):
    """Of bags with many definitions between them, only some are kept."""
    paths = [written(tmp_path / str(k), 'uint32 it\n') for k in range(2)]
    with open_bag(paths[0]) as one, open_bag(paths[1]) as two:
        assert one.typestore is two.typestore
        first = one.typestore
    for k in range(others):
        with open_bag(written(tmp_path / f'other_{k}', f'uint32 it_{k}\n')) as bag:
            assert getattr(bag.first('/it'), f'it_{k}') == 0x04030201
    with open_bag(paths[0]) as again:
        assert (again.typestore is first) == (others == 0)
        assert again.first('/it').it == 0x04030201


def connection(name, kind, text=''):
    """Return a connection with a definition of this kind."""
    return Connection(1, '/it', name, MessageDefinition(kind, text), '', 1, None, None)


IDL = 'module my_msgs { module msg { struct %s { %s it; }; }; };\n'
RULE = 80 * '=' + '\n'


@pytest.mark.parametrize('text', [
    IDL % ('It', 'uint32'),
    f'{RULE}IDL: my_msgs/msg/Whole\n{IDL % ("Whole", "my_msgs::msg::It")}'
    f'{RULE}IDL: my_msgs/msg/It\n{IDL % ("It", "uint32")}'], ids=['one', 'with its parts'])
def test_definitions_in_idl(text):
    """As rosbag2 stores them: bare, or each type of it under its name."""
    name = 'my_msgs/msg/Whole' if 'Whole' in text else 'my_msgs/msg/It'
    store = typestore_of([connection(name, MessageDefinitionFormat.IDL, text)])
    message = store.deserialize_cdr(b'\0\1\0\0\1\2\3\4', name)
    assert getattr(message.it, 'it', message.it) == 0x04030201


def test_types_of_a_bag_without_definitions_are_those_of_ros():
    name = 'std_msgs/msg/UInt32'
    store = typestore_of([connection(name, MessageDefinitionFormat.NONE)])
    message = store.deserialize_cdr(b'\0\1\0\0\1\2\3\4', name)
    assert message.data == 0x04030201


def test_a_definition_of_another_hash_than_stated_is_refused(tmp_path):
    path = written(tmp_path / 'bag', 'uint32 it\n')
    metadata = path / 'metadata.yaml'
    text = metadata.read_text()
    stated = re.search(r'RIHS01_[0-9a-f]{64}', text)[0]
    metadata.write_text(text.replace(stated, 'RIHS01_' + 64 * '0'))
    with pytest.raises(BagError, match=f'my_msgs/msg/It has the hash {stated}; the bag states'):
        open_bag(path)
