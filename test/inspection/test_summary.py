"""What a run says of its bag at its end: here, of the frames that a SLAM program got."""

import synthetic_bag as synthetic

from lunar_rover_sim import topics
from lunar_rover_sim.inspection.summary import summarise


def states(*told):
    """Return what slam_node publishes of frames 50 ms apart."""
    return [synthetic.Item(topics.SLAM_STATUS.name, topics.SLAM_STATUS.type, synthetic.msg(
        'diagnostic_msgs/DiagnosticArray', header=synthetic.header(50_000_000 * k, ''),
        status=[synthetic.msg('diagnostic_msgs/DiagnosticStatus', level=0, name='slam',
                              message=state, hardware_id='', values=[])]))
            for k, state in enumerate(told, start=1)]


def test_frames_are_counted_by_what_became_of_them(tmp_path):
    path = synthetic.write(tmp_path / 'bag', states('initialising', 'tracking', 'lost',
                                                    'initialising', 'tracking', 'tracking'))
    summary = summarise(path)
    assert summary.slam == {'initialising': 2, 'tracking': 3, 'lost': 1}
    assert 'slam: 6 frames answered: 2 initialising, 1 lost, 3 tracking' \
        in summary.lines().splitlines()


def test_without_a_slam_program_there_is_no_line(tmp_path):
    items = [i for i in synthetic.drive(0.2) if i.topic == topics.ODOM.name]
    summary = summarise(synthetic.write(tmp_path / 'bag', items))
    assert summary.slam == {}
    assert 'slam' not in summary.lines()
