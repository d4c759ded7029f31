"""States in files: what goes in comes out, bit for bit, and nothing is run."""

from collections import deque
import json
import math

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.command import NavigatorCommand, Status
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.state_file import (attributes, load_state, restore_attributes,
                                                   save_state)


def test_a_state_comes_back(tmp_path):
    shared = np.arange(6.0).reshape(2, 3)
    record = np.zeros(2, [('a', np.float64, 3), ('b', np.bool_)])
    generator = np.random.default_rng(3)
    generator.standard_normal(5)
    state = {
        'numbers': [1, -2.5, math.inf, True, None, 1 << 70, np.float32(0.1)], (1, 2): 'text',
        'bytes': b'\x00\xff', 'queue': deque([1, (2, 3)], maxlen=4), 'set': {1, 2},
        'arrays': (shared, record), 'again': shared, 'generator': generator,
        'command': NavigatorCommand(0.1, math.nan, Status.LOOKING)}
    save_state(tmp_path / 'a.npz', state)
    found = load_state(tmp_path / 'a.npz')
    assert found['numbers'] == state['numbers'] and found['again'] is found['arrays'][0]
    assert type(found['numbers'][-1]) is np.float32
    np.testing.assert_array_equal(found['again'], shared)
    assert found['arrays'][1].dtype == record.dtype
    assert found['queue'] == state['queue'] and found['queue'].maxlen == 4
    assert found['bytes'] == b'\x00\xff' and found['set'] == {1, 2} and found[1, 2] == 'text'
    assert found['command'].status is Status.LOOKING and math.isnan(
        found['command'].yaw_rate_radps)
    assert found['generator'].standard_normal() == generator.standard_normal()


def test_a_queue_stays_the_same_object():
    class Thing:
        def __init__(self, values: list[int]) -> None:
            self.queue, self.number = deque(values), len(values)

    one, other = Thing([1, 2, 3]), Thing([])
    held = other.queue
    restore_attributes(other, attributes(one, 'queue', 'number'))
    assert other.queue is held == deque([1, 2, 3]) and other.number == 3


def test_code_is_neither_written_nor_read(tmp_path):
    with pytest.raises(TypeError, match='cannot be a part of a state'):
        save_state(tmp_path / 'a.npz', {'f': print})
    with pytest.raises(TypeError, match='cannot be a part of a state'):
        save_state(tmp_path / 'a.npz', np.array([print]))
    assert not list(tmp_path.iterdir())
    for number, objects, match in ((2, [['object', ['os:system', {}]]], 'no module of'),
                                   (7, [], 'format 7 is not valid; valid is 2')):
        tree = json.dumps({'format': number, 'objects': objects, 'root': [0]}).encode()
        np.savez(tmp_path / 'b.npz', tree=np.frombuffer(tree, np.uint8))
        with pytest.raises(ConfigError, match=match):
            load_state(tmp_path / 'b.npz')
