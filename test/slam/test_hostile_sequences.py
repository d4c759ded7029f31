"""Sequences are untrusted: what cannot be tracked is one SlamError that names the file."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.sequences.export import export
from lunar_rover_sim.slam import euroc_reader


@pytest.fixture(scope='module')
def exported(tmp_path_factory) -> Path:
    """Return an exported sequence of two frames."""
    folder = tmp_path_factory.mktemp('sequence')
    bag = synthetic.write(folder / 'bag', synthetic.drive(0.2, state_hz=50))
    export(bag, folder / 'euroc', 'euroc')
    return folder / 'euroc'


def replaced(exported: Path, name: str, old: str, new: str) -> None:
    """Read the sequence with another text in one file; the file is as before afterwards."""
    file = exported / name
    before = file.read_bytes()
    assert old.encode() in before
    file.write_bytes(before.replace(old.encode(), new.encode('latin-1'), 1))
    try:
        list(euroc_reader.read_frames(exported, euroc_reader.read_camera(exported, True)))
    finally:
        file.write_bytes(before)


@pytest.mark.parametrize(('old', 'new', 'message'), [
    ('T_BS', 'T_SB', 'data: None is not 16 numbers'), ('T_BS:', '\xff', 'is not UTF-8'),
    ('intrinsics: [', 'intrinsics: [many, ', 'intrinsics: .* is not 4 numbers'),
    ('intrinsics: [', 'intrinsics: [-', 'focal lengths .* are not positive'),
    ('intrinsics: [', 'intrinsics: [1e300, ', 'intrinsics: .* is not 4 numbers'),
    ('distortion_coefficients: [', 'distortion_coefficients: [[1], ', 'coefficients: .* is not 4'),
    ('data: [', 'data: [7', 'T_BS is not a pose'), ('T_BS', '[' * 3000, 'not valid YAML')])
def test_calibration(exported, old, new, message):
    with pytest.raises(SlamError, match=message):
        replaced(exported, 'mav0/cam0/sensor.yaml', old, new)


@pytest.mark.parametrize('stamp', ['many', '-1', '1.5', '9' * 19, '1' * 5000, '٣'.encode().decode(
    'latin-1')])
def test_stamps(exported, stamp):
    with pytest.raises(SlamError, match='times.txt: .* is not a stamp'):
        replaced(exported, 'times.txt', '1704067200100000000', stamp)


def test_pictures(exported, capfd):
    with pytest.raises(SlamError, match='1704067200100000000.png: cannot be read as a picture'):
        replaced(exported, 'mav0/cam0/data/1704067200100000000.png', 'IDAT', 'IDAX')
    assert capfd.readouterr().err == ''
