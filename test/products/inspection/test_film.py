"""Films of drives: what they show, and what is refused."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from command_line import unfolded
from conftest import PLAIN
import cv2
import numpy as np
from PIL import Image
import pytest
import synthetic_bag as synthetic
from synthetic_ground import ground_items
import worlds

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError
from lunar_rover_sim.base.files.film_file import U8, write_film
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.products.inspection.film import Film, FilmOptions
from lunar_rover_sim.run.scenario import Scenario


class Recorded(NamedTuple):
    """A bag, and the folder of its world."""

    bag: Path
    world: Path


@pytest.fixture(scope='module')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A drive of half a second in a small world, with prints in the ground."""
    folder = tmp_path_factory.mktemp('film')
    moon = worlds.small()
    save_world(moon, folder / 'moon')
    items = [item for item in synthetic.drive(0.5)
             if item.topic not in (topics.WORLD_HASH.name, topics.SCENARIO.name)]
    for topic, data in ((topics.WORLD_HASH, moon.hash),
                        (topics.SCENARIO, Scenario.load('soft', PLAIN).to_yaml())):
        items.insert(0, synthetic.text(topic, data))
    items += ground_items(0.5)
    order = sorted(items, key=lambda item: item.fallback_ns or (
        header_ns(item.message) if hasattr(item.message, 'header') else 0))
    return Recorded(synthetic.write(folder / 'bag', order), folder / 'moon')


def test_frames(recorded: Recorded) -> None:
    """One frame a period: the view from outside, the recorded image in its corner."""
    film = Film(recorded.bag, FilmOptions(width=320, rate_hz=5.0, start_s=0.1), recorded.world)
    assert film.times_ns.tolist() == [10**8, 3 * 10**8, 5 * 10**8]
    frames = list(film.frames())
    assert len(frames) == 3
    for frame in frames:
        assert frame.shape == (180, 320, 3) and frame.dtype == np.uint8
        assert frame[60:, 80:].std() > 5.0
    with open_bag(recorded.bag) as bag:
        shown = [message for _, _, message in bag.messages([topics.LEFT_IMAGE.name])][4]
    pixels = np.frombuffer(bytes(shown.data), np.uint8).reshape(shown.height, shown.width)
    small = cv2.resize(pixels, (80, 60), interpolation=cv2.INTER_AREA).astype(float)
    inset = frames[-1][:60, :80, 0].astype(float)
    assert np.median(np.abs(inset - small)) < 1.0
    *_, bare = Film(recorded.bag, FilmOptions(width=320, rate_hz=5.0, start_s=0.1, bare=True),
                    recorded.world).frames()
    assert np.array_equal(bare[61:, 81:], frames[-1][61:, 81:])
    assert not np.array_equal(bare[:60, :80], frames[-1][:60, :80])


def test_files(recorded: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command writes a film that other programs read; it never replaces one."""
    output = tmp_path / 'drive.mp4'
    arguments = ['bag', 'video', str(recorded.bag), '--world', str(recorded.world), '--width',
                 '320', '--fps', '10', '--start', '0.3', '--bare', '--behind', '-o']
    assert main([*arguments, str(output)]) == 0
    assert '3 frames, 0.3 s' in capsys.readouterr().out
    reader = cv2.VideoCapture(str(output))
    assert (reader.get(cv2.CAP_PROP_FRAME_WIDTH), reader.get(cv2.CAP_PROP_FPS)) == (320, 10)
    count = 0
    while reader.read()[0]:
        count += 1
    assert count == 3
    assert b'vp09' in output.read_bytes()
    assert main([*arguments, str(output)]) == 1
    assert 'exists already; choose another name' in unfolded(capsys.readouterr().err)
    assert main([*arguments, str(tmp_path / 'drive.avi')]) == 1
    assert '.mp4' in unfolded(capsys.readouterr().err)
    assert [path.name for path in tmp_path.iterdir()] == ['drive.mp4']


@pytest.mark.parametrize('suffix', ['.gif', '.webp'])
def test_animated_pictures(tmp_path: Path, suffix: str) -> None:
    """All frames are in, in their order, each for its time, and it repeats."""
    def frames() -> Iterator[U8]:
        for k in range(4):
            yield np.full((12, 16, 3), 60 * k, np.uint8)

    path = tmp_path / f'film{suffix}'
    assert write_film(path, frames(), 10.0, quality=90) == 4
    with Image.open(path) as picture:
        assert picture.n_frames == 4                        # type: ignore[attr-defined]
        for k in range(4):
            picture.seek(k)
            assert abs(np.asarray(picture.convert('L')).mean() - 60 * k) < 4
            assert picture.info['duration'] == 100
        assert picture.info['loop'] == 0


def test_a_film_that_fails_leaves_no_file(tmp_path: Path) -> None:
    """Neither a part of the film nor a temporary file is left."""
    def frames() -> Iterator[U8]:
        yield np.zeros((32, 32, 3), np.uint8)
        raise BagError('the bag ends here')

    for suffix in ('.mp4', '.gif'):
        with pytest.raises(BagError):
            write_film(tmp_path / f'film{suffix}', frames(), 10.0)
    assert not list(tmp_path.iterdir())


def test_a_film_replaces_no_file(tmp_path: Path) -> None:
    """A file that came while it was drawn stays, and it is one line."""
    def frames() -> Iterator[U8]:
        yield np.zeros((32, 32, 3), np.uint8)
        (tmp_path / 'film.gif').write_text('other')

    with pytest.raises(ConfigError, match='film.gif: exists already$'):
        write_film(tmp_path / 'film.gif', frames(), 10.0)
    assert [path.read_text() for path in tmp_path.iterdir()] == ['other']


@pytest.mark.parametrize('options', [
    ['--end', '0.2', '--start', '0.4'], ['--end', '9'], ['--width', '333'],
    ['--tripod', '1,1,-0.5'], ['--tripod', '9000,1,0.5'], ['--behind', '--tripod', '1,1,1'],
    ['--quality', '70'], ['--world', 'nowhere']])
def test_bad_input(recorded: Recorded, options: list[str], tmp_path: Path,
                   capsys: pytest.CaptureFixture[str]) -> None:
    """One line that names the first option, before anything is drawn or written."""
    given = ['bag', 'video', str(recorded.bag), '-o', str(tmp_path / 'drive.mp4')]
    given += [] if '--width' in options else ['--width', '320']
    given += [] if '--world' in options else ['--world', str(recorded.world)]
    assert main([*given, *options]) == 1
    error = unfolded(capsys.readouterr().err)
    assert options[0] in error and error.count('\n') == 1
    assert not list(tmp_path.iterdir())


def test_bags_without_a_film(recorded: Recorded, tmp_path: Path,
                             monkeypatch: pytest.MonkeyPatch) -> None:
    """A bag without images, or whose world is gone, is refused with what to do."""
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))    # without worlds
    with pytest.raises(BagError, match='name its folder with --world'):
        Film(recorded.bag)
    blind = synthetic.write(tmp_path / 'blind', [
        synthetic.text(topics.SCENARIO, Scenario.load('flat').to_yaml())])
    with pytest.raises(BagError, match='holds no stereo/left/image_raw; --bare'):
        Film(blind, FilmOptions(), recorded.world)


def test_wall_time_in_the_bag(recorded: Recorded, tmp_path: Path) -> None:
    """A film ends with the drive where /diagnostics was recorded, which bears wall time."""
    with open_bag(recorded.bag) as bag, BagWriter(tmp_path / 'bag') as writer:
        for message in bag.raw():
            writer.add_topic(message.topic, message.msgtype)
            writer.write_at(message.topic, message.time_ns, message.data)
        writer.add_topic('/diagnostics', topics.DIAGNOSTICS.type)
        writer.write_at('/diagnostics', 1_795_554_234 * 10**9, b'')
    film = Film(tmp_path / 'bag', FilmOptions(width=320, rate_hz=5.0), recorded.world)
    assert film.times_ns.tolist() == [0, 2 * 10**8, 4 * 10**8]
    with pytest.raises(ConfigError, match=r'--end: 9 s is not valid; the bag holds 0 to 0\.5 s'):
        Film(tmp_path / 'bag', FilmOptions(end_s=9.0), recorded.world)
