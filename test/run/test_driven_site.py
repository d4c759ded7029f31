"""In which window of its site the rover of a bag was."""

import numpy as np
import pytest
from windows_scene import CutSite, window

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.regolith.patch import changed_patch
from lunar_rover_sim.run import recorded_run
from lunar_rover_sim.run.recorded_run import DrivenSite

AT = (12.8, 0.0)


@pytest.fixture(name='driven')
def _driven(monkeypatch):
    """Return a drive from the origin to the east and back, in windows of 12.8 m."""
    site = CutSite(AT, half_m=6.4)
    monkeypatch.setattr(recorded_run.Site, 'of', lambda world: site)
    return DrivenSite(window((0.0, 0.0), 6.4, AT),
                      [(0, (0.0, 0.0)), (5_000, (12.8, 0.0)), (9_000, (0.0, 0.0))]), site


def test_the_window_of_a_time_is_that_of_the_last_message_before(driven):
    site = driven[0]
    found = [site.at(ns).ground.middle_m[0] for ns in (0, 4_999, 5_000, 8_999, 9_000, 99_000)]
    assert found == [0.0, 0.0, 12.8, 12.8, 0.0, 0.0]
    assert site.at() is site.world and site.reach_m == pytest.approx(19.2)


def test_a_window_is_read_once_while_it_lasts(driven):
    site, windows = driven
    for ns in range(5_000, 9_000, 100):
        site.at(ns)
    assert windows.entered_m == [(12.8, 0.0)]


def test_a_drive_that_starts_elsewhere_is_there_from_the_first_state_on(monkeypatch):
    site = CutSite(AT, half_m=6.4)
    monkeypatch.setattr(recorded_run.Site, 'of', lambda world: site)
    driven = DrivenSite(window((0.0, 0.0), 6.4, AT), [(100, (12.8, 0.0))])
    assert driven.at(0).ground.middle_m == (12.8, 0.0)


def test_a_bag_without_windows_has_the_world_of_its_hash():
    world = window((0.0, 0.0), 6.4, AT)
    assert DrivenSite(world, ()).at(5) is world


def test_the_changed_part_of_a_window_is_in_the_site_and_ends_with_it():
    """Tracks beside the window stay out; those within are where they were trodden."""
    ground = window((12.8, 0.0), 6.4, AT).ground
    overlay = Overlay()
    for x in (3.0, 12.0):
        overlay.put(round(x / CELL_M), 0, np.full((4, 4), -0.01), np.full((4, 4), 0.005))
    patch = changed_patch(ground, overlay)
    assert patch.x_m[0] > 11.0 and patch.x_m[-1] < 13.0
    deep = patch.x_m[(patch.change_m < 0.0).any(axis=0)]
    np.testing.assert_allclose(deep, 12.0 + CELL_M * np.arange(4), atol=1e-6)
    np.testing.assert_allclose(patch.around((12.8, 0.0)).x_m, patch.x_m - 12.8)
    y, x = np.meshgrid(patch.y_m, patch.x_m, indexing='ij')
    np.testing.assert_allclose(patch.height_m - patch.change_m,
                               ground.height_at(np.stack([x, y], -1)), atol=1e-6)
    with pytest.raises(WorldError, match='untouched'):
        changed_patch(window((64.0, 0.0), 6.4, AT).ground, overlay)
