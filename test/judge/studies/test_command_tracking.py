"""The commands around the walk: what they keep, and short studies from end to end."""

import re

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli.main import execute


def run(*words):
    return execute(words)


def test_a_short_pitch_study_from_end_to_end(tmp_path, capsys):
    words = ('validate', 'locomotion', '--speeds', '0.12', '--gravities', '1.62', '--duration',
             '13', '--no-commands', '--grounds', '-o', str(tmp_path / 'out'))
    assert run(*words) == 0
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == [
        'locomotion.md', 'locomotion.png', 'pitch.csv']
    text = (tmp_path / 'out' / 'locomotion.md').read_text()
    for words in ('start transient', 'step frequency', 'smooth interface', 'no interface peak'):
        assert words in text
    assert (tmp_path / 'out' / 'locomotion.png').stat().st_size > 10000
    header, *rows = (tmp_path / 'out' / 'pitch.csv').read_text().splitlines()
    assert header == 'time_s,gait_0.12mps_1.62mps2_deg,interface_0.12mps_1.62mps2_deg'
    assert len(rows) == 14 * 200
    misses = re.findall(r'^\| 0.12 \| 1.62 \| (\d+) \| ([\d.]+) \|', text, re.MULTILINE)
    rates, medians_px = zip(*[(int(rate), float(median)) for rate, median in misses])
    assert rates == (10, 20, 40) and medians_px[0] > 3.0 * medians_px[1] > 9.0 * medians_px[2]
    assert 'start transient' in capsys.readouterr().out


@pytest.mark.parametrize(('words', 'output', 'said'), [
    ('validate locomotion', '', 'exists; name a new folder'),
    ('validate navigation', '', 'exists; name a new folder'),
    ('calibrate gait', 'report.md', 'report.md exists already; choose another')])
def test_an_earlier_report_is_kept(tmp_path, words, output, said):
    (tmp_path / 'report.md').write_text('an hour of work')
    with pytest.raises(ConfigError, match=said):
        run(*words.split(), '-o', str(tmp_path / output))
    assert [path.read_text() for path in tmp_path.iterdir()] == ['an hour of work']


def test_a_short_odometry_study_from_end_to_end(capsys):
    small = ('world.size_m=12.8', 'world.surroundings.samples=257', 'world.rocks.abundance=0')
    assert run('validate', 'odometry', 'feature_sparse', '-n', '3', '--duration', '5',
               *(word for item in small for word in ('--set', item))) in (0, 1)
    said = capsys.readouterr().out
    assert '3 drives of 5 s on feature_sparse' in said
    (scale,) = re.findall(r'physics_node.wheel_odometry.forward_scale=([\d.]+)', said)
    # Over twelve sets of seeds the scale of three short drives is 0.96 with a spread of 0.06: five
    # of those.
    assert 0.67 < float(scale) < 1.26
