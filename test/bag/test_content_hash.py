"""The hash of a bag: every value counts, and neither the container nor the log does."""

import copy

import numpy as np
import psutil
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.content_hash import bag_hash, is_skipped, topic_hashes
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.cli.main import main


@pytest.fixture(scope='module')
def items():
    return synthetic.drive(0.1, frame_hz=10)


@pytest.fixture(scope='module')
def original(items, tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp('hash') / 'bag', items)


def odometry(items):
    """Return the index of an odometry message in the middle."""
    found = [i for i, item in enumerate(items) if item.topic.endswith('odom')]
    assert len(found) > 5
    return found[len(found) // 2]


def changed(items, change):
    """Return a copy of the items with one odometry message changed."""
    result = list(items)
    i = odometry(items)
    result[i] = copy.deepcopy(items[i])
    change(result[i].message)
    return result


def test_the_same_messages_have_one_hash_in_any_container_and_order(items, original, tmp_path):
    ordered = sorted(items, key=lambda item: item.topic)     # of each topic as before
    other = synthetic.write_sqlite(tmp_path / 'other', ordered, compression='zstd')
    assert bag_hash(other) == bag_hash(original)
    assert topic_hashes(other) == topic_hashes(original)


def test_the_folder_of_a_run_stands_for_its_bag(original, capsys):
    assert original.name == 'bag'
    for path in (original, original.parent):
        assert main(['bag', 'hash', str(path)]) == 0
        with open_bag(path) as bag:
            assert bag.path == original
    first, second = capsys.readouterr().out.split()
    assert first == second == bag_hash(original)


def test_the_smallest_change_of_one_value_changes_the_hash_of_its_topic(items, original, tmp_path):
    def nudge(message):
        message.pose.pose.position.x += 1e-15

    other = synthetic.write(tmp_path / 'other', changed(items, nudge))
    assert bag_hash(other) != bag_hash(original)
    before, after = topic_hashes(original), topic_hashes(other)
    differ = {name.lstrip('/') for name in before if before[name] != after[name]}
    assert differ == {items[odometry(items)].topic.lstrip('/')}


def test_a_message_more_or_less_changes_the_hash(items, original, tmp_path):
    fewer = list(items)
    del fewer[odometry(items)]
    assert bag_hash(synthetic.write(tmp_path / 'fewer', fewer)) != bag_hash(original)


@pytest.mark.parametrize('stamp_ns', [None, 5_000_000])
def test_what_has_no_stamp_counts_and_messages_of_one_stamp_have_no_order(stamp_ns, tmp_path):
    def said(name, *texts):
        items = ([synthetic.text(topics.SCENARIO, text) for text in texts] if stamp_ns is None
                 else [synthetic.item(topics.ODOM, synthetic.odometry(stamp_ns, text, np.eye(4)))
                       for text in texts])
        return bag_hash(synthetic.write(tmp_path / name, items))

    first = said('first', 'one', 'other')
    assert said('again', 'one', 'other') == first
    assert said('changed', 'one', 'another') != first and said('fewer', 'one') != first
    # Who comes first of one stamp is chance; what has none is in the order of the log.
    assert (said('turned', 'other', 'one') == first) == (stamp_ns is not None)


@pytest.mark.parametrize('topic,skipped', [('/rosout', True), ('/rover/rosout', True),
                                           ('rosout', True), ('/my_rosout', False),
                                           ('/odom', False), ('/diagnostics', True)])
def test_topics_of_wall_time_do_not_count(topic, skipped):
    assert is_skipped(topic) == skipped


def test_a_closed_bag_holds_no_file(original):
    def ours():
        return [file.path for file in psutil.Process().open_files() if str(original) in file.path]

    with open_bag(original) as bag:
        assert list(bag.types)
        next(iter(bag.raw(list(bag.types))))
        assert ours()
    assert not ours()
    bag.close()     # twice does no harm
