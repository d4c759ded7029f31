"""Estimators on recordings: right, wrong, lost or crashing ones; and damaged sequences."""

import json
from pathlib import Path
import sys
import textwrap
import time

from command_line import unfolded
from judge.slam.fed_frames import VOCABULARY
import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, EvaluationError, ProcessError, SlamError
from lunar_rover_sim.base.seconds import EPOCH_NS
from lunar_rover_sim.cli.main import execute, main
from lunar_rover_sim.judge.evaluation.trajectory_files import load, write_tum
from lunar_rover_sim.judge.slam import euroc_reader
from lunar_rover_sim.judge.slam.estimators import Estimator, read_estimate
from lunar_rover_sim.judge.slam.run_on_bag import run_on_bag, SlamResult
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.run.recorded_run import RecordedRun

SCALE = 1.25
# Takes what stereo_euroc takes; writes the poses of `truth.txt` beside the vocabulary.
FAKE = """\
    #!{python}
    import os, pathlib, sys, time
    vocabulary, settings, sequence, times, name = sys.argv[1:6]
    assert pathlib.Path(settings).read_text().startswith('%YAML:1.0')
    assert (pathlib.Path(sequence) / 'mav0' / 'cam0' / 'data').is_dir()
    stamps = [int(line) for line in open(times)]
    print('frames', len(stamps), flush=True)
    kind = (pathlib.Path(vocabulary).parent / 'kind.txt').read_text()
    if kind == 'crash':
        os.abort()
    if kind == 'hang':
        time.sleep(600)
    rows = [line.split() for line in open(pathlib.Path(vocabulary).parent / 'truth.txt')]
    rows = {{round(float(row[0]) * 1e9): row[1:] for row in rows}}
    with open('f_' + name + '.txt', 'w') as file:
        for k, ns in enumerate(stamps):
            if kind == 'nothing' or (kind == 'half' and k >= len(stamps) // 2):
                break
            pose = [float(v) for v in rows[ns]]
            pose[:3] = [v / {scale} for v in pose[:3]]
            if kind == 'nan' and k == 3:
                pose[0] = float('nan')
            print('%.6f' % (ns + (k % 3 - 1) * 256.0), *pose, file=file)
    if kind == 'late-crash':
        os.abort()
"""


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp('slam') / 'bag',
                           synthetic.drive(3.0, state_hz=50, only=synthetic.FOR_ESTIMATORS))


@pytest.fixture(scope='module')
def truth(bag):
    """Return the true trajectory of the left camera."""
    with open_bag(bag) as opened:
        return load(bag).of_frame(RecordedRun(opened).frame('left'))


@pytest.fixture
def fake(tmp_path, truth):
    """Return a maker of estimators, by what goes wrong."""
    program = tmp_path / 'stereo_euroc'
    program.write_text(textwrap.dedent(FAKE).format(python=sys.executable, scale=SCALE))
    program.chmod(0o755)
    write_tum(tmp_path / 'truth.txt', truth)

    def make(kind: str, **more) -> Estimator:
        (tmp_path / 'vocabulary.txt').write_text(VOCABULARY)
        (tmp_path / 'kind.txt').write_text(kind)
        return Estimator('orbslam3', 'stereo', program, tmp_path / 'vocabulary.txt', **more)

    (tmp_path / 'out').mkdir()
    return make


def test_known_error(tmp_path, bag, fake) -> None:
    lines: list[str] = []
    result = run_on_bag(bag, fake('fine'), tmp_path / 'out', lines.append)
    assert result.reason == ''
    assert result.scale == pytest.approx(SCALE, rel=1e-9)
    assert result.tracked_share == 1.0
    assert lines == [f'frames {result.frames}']
    assert (tmp_path / 'out' / 'log.txt').read_text().split() == lines[0].split()
    path = np.load(tmp_path / 'out' / 'path.npz')
    expected = np.sqrt(np.mean(np.sum((path['truth_m'] - path['estimate_m'])**2, axis=1)))
    assert result.ate_m == pytest.approx(expected)
    assert not (tmp_path / 'out' / 'sequence').exists()
    again = SlamResult.from_mapping(json.loads(json.dumps(result.to_mapping())))
    assert repr(again) == repr(result)   # NaN and all


@pytest.mark.parametrize(('kind', 'share', 'reason'), [
    ('half', 0.5, 'lost at 1.'), ('nothing', 0.0, 'lost'),
    ('late-crash', 1.0, 'crashed with SIGABRT')])
def test_what_is_lost_or_crashes_at_the_end_has_a_result(tmp_path, bag, fake, kind, share,
                                                         reason) -> None:
    result = run_on_bag(bag, fake(kind), tmp_path / 'out')
    assert reason in result.reason
    assert result.tracked_share == pytest.approx(share, abs=1.0 / result.frames)
    assert np.isfinite(result.ate_m) == (share > 0.0)


@pytest.mark.parametrize(('kind', 'said', 'options'), [
    ('crash', 'stereo_euroc: crashed with SIGABRT.*frames', {}),
    ('hang', 'stereo_euroc: was ended after', {'timeout_s': 1.5}),     # it would sleep 600 s
    ('nan', 'f_run.txt.*not finite', {})])
def test_what_crashes_hangs_or_writes_no_numbers_is_named(tmp_path, bag, fake, kind, said,
                                                          options) -> None:
    start = time.monotonic()
    with pytest.raises(SlamError, match=said):
        run_on_bag(bag, fake(kind, **options), tmp_path / 'out')
    assert time.monotonic() - start < 300.0


def test_orb_slam3_is_given_no_images_of_16_bits(tmp_path, fake) -> None:
    """It takes any image for one of 8 bits."""
    items = synthetic.drive(0.3, only=synthetic.FOR_ESTIMATORS)
    pixels = np.zeros((synthetic.HEIGHT, synthetic.WIDTH), np.uint16)
    for item in items:
        if item.topic in (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name):
            item.message = synthetic.image(header_ns(item.message), 'camera', 'mono16', pixels)
    deep = synthetic.write(tmp_path / 'deep', items)
    with pytest.raises(SlamError, match='mono16 are not valid for ORB-SLAM3; valid are mono8'):
        run_on_bag(deep, fake('fine'), tmp_path / 'out')
    (note,) = [note for note in export(deep, tmp_path / 'seq') if 'ORB-SLAM3' in note]
    assert note.startswith('16 bits: stereo/left/image_raw, stereo/right/image_raw; ')


@pytest.mark.parametrize('arguments, message', [
    ({'system': 'vins'}, 'system: .vins. is not valid'),
    ({'sensor': 'lidar'}, 'sensor: .lidar. is not valid'),
    ({'sensor': 'rgbd'}, 'not valid for the reference'),
    ({'system': 'orbslam3'}, 'needs --executable and --vocabulary'),
    ({'system': 'orbslam3', 'program': Path(sys.executable)}, 'needs --vocabulary'),
    ({'system': 'orbslam3', 'program': Path('/no/such'), 'vocabulary': Path('/no')},
     '/no/such: there is no such program'),
    ({'system': 'command'}, '--run: missing; it is the command line'),
    ({'system': 'command', 'command': '/no/such {out}'}, '/no/such: there is no such program'),
    ({'system': 'command', 'command': 'true {nope}'}, "'nope'; valid fields are sequence"),
    ({'system': 'command', 'command': 'true "{out}'}, 'No closing quotation'),
])
def test_bad_estimator(arguments, message) -> None:
    with pytest.raises((ProcessError, SlamError), match=message):
        Estimator(**arguments)


@pytest.mark.parametrize('content', [
    b'', b'%YAML:1.0\n', b'stamp x y z\n1 2 3 4\n', b'10 6 0 0\n', b'\x1f\x8b\x08\x00',
    b'\x00\xff' * 5000, b'2 1 0 0\n0 1 300 ' + b'17 ' * 31 + b'0.69\n',
    b'\xb2 1 0 0\n0 1 ' + b'17 ' * 32 + b'0.69\n'])
def test_a_wrong_vocabulary_is_found_before_anything_is_done(tmp_path, bag, capsys,
                                                             content) -> None:
    path = tmp_path / 'words.txt'
    path.write_bytes(content)
    assert main(['slam', 'run', str(bag), '-o', str(tmp_path / 'out'), '--system', 'orbslam3',
                 '--executable', sys.executable, '--vocabulary', str(path)]) == 1
    said = unfolded(capsys.readouterr().err)
    assert 'words.txt: is' in said and 'such as ORBvoc.txt' in said
    assert not (tmp_path / 'out').exists()


def test_a_program_with_an_imu_is_given_the_frames_that_samples_enclose(tmp_path, bag) -> None:
    """All 30 pairs are exported; a sample follows 29, and a loop that reads past one ends."""
    export(bag, tmp_path / 'seq')
    assert len(euroc_reader.stamps_ns(tmp_path / 'seq')) == 30
    imu = np.loadtxt(tmp_path / 'seq' / 'mav0/imu0/data.csv', delimiter=',')[:, 0]
    for sensor, frames in (('stereo', 30), ('stereo-inertial', 29)):
        script = 'import sys; print(open(sys.argv[1]).read(), end="")'
        estimator = Estimator('command', sensor,
                              command=f"{sys.executable} -c '{script}' {{times}}")
        (tmp_path / sensor).mkdir()
        result = run_on_bag(bag, estimator, tmp_path / sensor)
        stamps = list(map(int, (tmp_path / sensor / 'log.txt').read_text().split()))
        assert result.frames == len(stamps) == frames
    assert imu[0] - EPOCH_NS <= stamps[0] and stamps[-1] < imu[-1] - EPOCH_NS


def test_stamps_of_early_frames(tmp_path) -> None:
    """Simulated time begins at 0: 5e9 is 5 s in ns, not 5e9 s."""
    frames = np.arange(1, 100, dtype=np.int64) * 100_000_000
    for unit in (1, 1e9):
        path = tmp_path / 'f.txt'
        path.write_text(''.join(f'{ns / unit + 0.0:.9f} {k} 0 0 0 0 0 1\n'
                                for k, ns in enumerate(frames)))
        assert np.array_equal(read_estimate(path, frames).stamps_ns, frames)


def test_repeated_poses_are_of_frames_that_were_not_located(tmp_path) -> None:
    """ORB-SLAM3 writes the last pose again while it looks for its place, stamp and all."""
    frames = np.arange(1, 10, dtype=np.int64) * 100_000_000
    lines = [f'{ns} {k} 0 0 0 0 0 1\n' for k, ns in enumerate(frames)]
    path = tmp_path / 'f.txt'
    path.write_text(''.join([*lines[:4], lines[3], lines[3], *lines[6:]]))
    assert np.array_equal(read_estimate(path, frames).stamps_ns, np.delete(frames, (4, 5)))
    path.write_text(''.join([*lines[:4], lines[3].replace(' 3 ', ' 3.5 '), *lines[4:]]))
    with pytest.raises(EvaluationError, match='stamps do not increase: pose 4'):
        read_estimate(path, frames)


def test_command_line(tmp_path, bag, capsys) -> None:
    """A program that writes nothing is no success."""
    words = ['slam', 'run', str(bag), '-o', str(tmp_path / 'result'), '--system', 'command',
             '--run', 'true {out}']
    assert main(words) == 1
    said = capsys.readouterr()
    assert 'lost: it wrote no pose' in said.out
    assert 'no trajectory to judge' in unfolded(said.err)
    assert json.loads((tmp_path / 'result' / 'result.json').read_text())['tracked_share'] == 0.0
    assert main(words) == 1
    assert 'result exists; name a new folder' in unfolded(capsys.readouterr().err)
    with pytest.raises(BagError, match='there is no such bag'):
        execute(['slam', 'run', '/no/bag', '-o', str(tmp_path / 'nothing')])
    assert not (tmp_path / 'nothing').exists()


@pytest.fixture(scope='module')
def exported(tmp_path_factory) -> Path:
    """Return an exported sequence of two frames."""
    folder = tmp_path_factory.mktemp('sequence')
    bag = synthetic.write(folder / 'bag', synthetic.drive(0.2, state_hz=50))
    export(bag, folder / 'euroc', 'euroc')
    return folder / 'euroc'


CALIBRATION, TIMES = 'mav0/cam0/sensor.yaml', 'times.txt'
PICTURE = 'mav0/cam0/data/1704067200100000000.png'


@pytest.mark.parametrize(('name', 'old', 'new', 'message'), [
    *((CALIBRATION, old, new, message) for old, new, message in (
        ('T_BS', 'T_SB', 'data: None is not 16 numbers'), ('T_BS:', '\xff', 'is not UTF-8'),
        ('intrinsics: [', 'intrinsics: [many, ', 'intrinsics: .* is not 4 numbers'),
        ('intrinsics: [', 'intrinsics: [1e300, ', 'intrinsics: .* is not 4 numbers'),
        ('intrinsics: [', 'intrinsics: [-', 'focal lengths .* are not positive'),
        ('distortion_coefficients: [', 'distortion_coefficients: [[1], ', 'is not 4'),
        ('data: [', 'data: [7', 'T_BS is not a pose'), ('T_BS', '[' * 3000, 'not valid YAML'))),
    *((TIMES, '1704067200100000000', stamp, 'times.txt: .* is not a stamp')
      for stamp in ('many', '-1', '1.5', '9' * 19, '1' * 5000, '٣'.encode().decode('latin-1'))),
    (PICTURE, 'IDAT', 'IDAX', '1704067200100000000.png: cannot be read as a picture')])
def test_damage_of_a_sequence_is_named(exported, capfd, name, old, new, message):
    file = exported / name
    before = file.read_bytes()
    assert old.encode() in before
    file.write_bytes(before.replace(old.encode(), new.encode('latin-1'), 1))
    try:
        with pytest.raises(SlamError, match=message):
            list(euroc_reader.read_frames(exported, euroc_reader.read_camera(exported, True)))
    finally:
        file.write_bytes(before)
    assert capfd.readouterr().err == ''
