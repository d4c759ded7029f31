"""The figure of the sky shows what was computed: curves are read back."""

import numpy as np
import pytest

from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.illumination import sky_figure
from lunar_rover_sim.illumination.light_time import sky_over_time, SkyOverTime
from lunar_rover_sim.world.site import Site

HOURS = np.datetime64('2026-03-01T00:00:00', 'us') + np.arange(0, 700, 7) * np.timedelta64(1, 'h')


def over(horizon_deg=2.0):
    """Return 29 days near the south pole before a horizon that rises to the north."""
    found = sky_over_time(Site(40.0, -88.0), HOURS)
    mask = horizon_deg * np.sin(np.radians(found.mask_azimuth_deg))
    return SkyOverTime(HOURS, found.sky, found.mask_azimuth_deg, mask,
                       np.interp(found.sky.sun.azimuth_deg, found.mask_azimuth_deg, mask),
                       np.where(found.sky.sun.elevation_deg > 0.0, 0.75, 0.0))


def curves(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_elevations_over_time_and_ways_over_the_horizon():
    sky = over()
    figure = sky_figure.figure(sky, 'a site')
    upper, lower = figure.axes
    assert figure.get_suptitle() == 'a site'
    lines = curves(upper)
    for name, values in (('sun', sky.sky.sun.elevation_deg),
                         ('Earth', sky.sky.earth.elevation_deg),
                         ('horizon below the sun', sky.horizon_deg)):
        np.testing.assert_allclose(lines[name][:, 1], values)
    labels = [text.get_text() for text in upper.get_legend().get_texts()]
    assert f'in light, {100.0 * sky.light_share:.1f} % of the time' in labels
    lines = curves(lower)
    for name, body in (('sun', sky.sky.sun), ('Earth', sky.sky.earth)):
        np.testing.assert_allclose(lines[name],
                                   np.stack([body.azimuth_deg, body.elevation_deg], axis=1))
    assert lower.get_xlim() == (0.0, 360.0)
    assert lower.get_xticks().tolist() == [45.0 * k for k in range(9)]


@pytest.mark.parametrize('horizon_deg', [2.0, -3.0])
def test_the_ground_is_filled_up_to_the_horizon(horizon_deg):
    """From a degree below its lowest point."""
    sky = over(horizon_deg)
    (area,) = sky_figure.figure(sky, '').axes[1].collections
    x, y = area.get_paths()[0].vertices.T
    assert (x.min(), x.max()) == (0.0, 360.0)
    assert y.min() == pytest.approx(-abs(horizon_deg) - 1.0)
    assert y.max() == pytest.approx(abs(horizon_deg), abs=1e-3)
    level = SkyOverTime(sky.dates_utc, sky.sky, sky.mask_azimuth_deg, 0.0 * sky.mask_deg + 4.0,
                        sky.horizon_deg, sky.lit)
    (area,) = sky_figure.figure(level, '').axes[1].collections
    assert area.get_paths()[0].vertices[:, 1].min() == -1.0


def test_light_is_shaded_over_the_whole_height_while_there_is_any():
    sky = over()
    upper = sky_figure.figure(sky, '').axes[0]
    (area,) = upper.collections
    low, high = upper.get_ylim()
    lines = np.concatenate([line.get_ydata() for line in upper.lines])
    assert low < lines.min() and high > lines.max()
    starts = np.flatnonzero(np.diff(np.concatenate([[False], sky.lit > 0.0, [False]]))[::1])
    assert 0.0 < sky.light_share < 0.75 and len(area.get_paths()) == len(starts) // 2
    for path in area.get_paths():
        assert set(np.round(path.vertices[:, 1], 9)) == {round(low, 9), round(high, 9)}


def test_it_is_written_or_the_reason_is_named(tmp_path):
    sky_figure.write(over(), tmp_path / 'sky.png', 'a site')
    assert (tmp_path / 'sky.png').read_bytes().startswith(b'\x89PNG')
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(WorldError, match='cannot be written'):
        sky_figure.write(over(), tmp_path / 'file' / 'sky.png', 'a site')
