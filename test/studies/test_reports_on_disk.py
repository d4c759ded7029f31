"""Plots and tables of the studies are written whole or not at all."""

from collections.abc import Callable
from pathlib import Path
import resource
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.studies.locomotion import PitchCurve
from lunar_rover_sim.studies.locomotion_report import plot_cases, write_curves
from lunar_rover_sim.studies.traverse import Traverse
from lunar_rover_sim.studies.traverse_report import plot_paths, write_csv

TIME_S = np.arange(0.0, 3.0, 0.1)
CASE: Any = SimpleNamespace(
    gravity_mps2=1.62, speed_mps=0.12, step_hz=1.0,
    gait=PitchCurve('gait', TIME_S, np.sin(TIME_S)),
    interface=PitchCurve('interface', TIME_S, 0.0 * TIME_S))
DRIVE = Traverse(3, 'driven', 60.0, 5.0, 1, 0, 0, 0.1, 1.0, 1.3, 5.0, 10.0, 20.0, 1.5, 0.005,
                 np.c_[np.linspace(0.0, 5.0, 50), np.zeros((50, 2))])
WRITERS: dict[str, Callable[[Path], None]] = {
    'locomotion.png': lambda path: plot_cases([CASE], path),
    'pitch.csv': lambda path: write_curves([CASE], path),
    'traverse.png': lambda path: plot_paths([DRIVE], path),
    'traverse.csv': lambda path: write_csv([DRIVE], path)}


@pytest.mark.parametrize('name', WRITERS)
def test_a_write_that_fails_leaves_no_file(name: str, tmp_path: Path) -> None:
    """Larger than a file may be: one line, the older file as it was, no part of the new one."""
    path = tmp_path / name
    path.write_text('older')
    _, most = before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, most))
    try:
        with pytest.raises(StudyError) as failed:
            WRITERS[name](path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert str(failed.value) == f'{path}: cannot be written: File too large'
    assert path.read_text() == 'older' and list(tmp_path.iterdir()) == [path]
    WRITERS[name](path)
    assert path.stat().st_size > 100


@pytest.mark.parametrize('name', WRITERS)
def test_a_folder_that_is_missing_is_one_line(name: str, tmp_path: Path) -> None:
    """As in the error of every other file."""
    path = tmp_path / 'none' / name
    with pytest.raises(StudyError, match=f'^{path}: cannot be written: No such file'):
        WRITERS[name](path)
