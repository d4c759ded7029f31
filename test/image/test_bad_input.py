"""Parameters of light, cameras, matcher and LiDAR that make no image: one line names each."""

from __future__ import annotations

from typing import Any

import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.run.node_config import LidarNodeConfig, RenderNodeConfig

DISTORTED = [-0.02, 0.004, -0.003, 0.0006]
RENDER = [
    {'chase': {'enabled': True, 'rate_hz': 7}},
    {'chase.camera.height': 541, 'chase.sensor.encoding': 'bayer_rggb16'},
    {'camera.width': 321, 'sensor.encoding': 'bayer_rggb8'},
    {'hazard.front.camera.width': 321, 'hazard.front.sensor.encoding': 'bayer_rggb8'},
    {'sensor.encoding': 'bayer_grbg8'}, {'sensor.red_response': [-0.1] + [0.0] * 15},
    {'sensor.blue_response': [0.0] * 16}, {'sensor.green_response': [0.5, 0.5]},
    {'reflectance.ground': 'higland'},
    {'sensor.psf_sigma_px': 0.64},
    {'stereo.left.image_raw.compressed.format': 'tiff'},
    {'stereo.left.image_raw.compressed.jpeg_quality': 0},
    {'camera.distortion': [-0.28, 0.0, 0.0, 0.0, 0.0], 'camera.horizontal_fov_deg': 62.0},
    {'hazard.front.camera.horizontal_fov_deg': 190.0},
    {'hazard.front.camera.horizontal_fov_deg': 180.0, 'hazard.front.camera.model': 'pinhole'},
    {'hazard.front.camera.fisheye_distortion': [-0.3, 0.0, 0.0, 0.0]},
    {'hazard.front.camera.distortion': [0.1, 0.0, 0.0, 0.0, 0.0]},
    {'hazard.front.camera.fisheye_distortion': DISTORTED, 'hazard.front.camera.model': 'pinhole',
     'hazard.front.camera.horizontal_fov_deg': 90.0},
    *({'sun.date': date} for date in ('yesterday', '2026-02-30', '1969-07-20T20:17:40Z',
                                      '2101-01-01', '0001-01-01T00:00:00+02:00')),
    {'sun.site.lat_deg': -89.5},
    {'sun.rate': 60.0},
    {'sun.step_deg': 0.0},
    {'sgm.num_disparities': 100},
    {'sgm.block_size': 4},
    {'sgm.mode': 'sgm'},
    {'sgm.p2': 200, 'sgm.p1': 300}]
LIDAR = [
    {'rate_hz': 40}, {'horizontal_beam': 16}, {'own.vertical_low_deg': 20.0},
    {'own.horizontal_deg': 360.0, 'own.kind': 'flash'}, {'own.elevations_deg': [1.0, 2.0]},
    {'own.firing_s': 1e-4}, {'own.min_range_m': 200.0}, {'own.limit_noise_m': 0.01},
    {'own.beams': 32}, {'own.firing_s': 1e-6, 'part': 'espros_tofcam635'},
    {'own.beams': 64, 'own.columns_per_s': 1e6, 'part': 'own'}]


@pytest.mark.parametrize('kind, values', [*((RenderNodeConfig, values) for values in RENDER),
                                          *((LidarNodeConfig, values) for values in LIDAR)])
def test_one_line_names_the_parameter(kind: Any, values: dict[str, Any]) -> None:
    """The first one that is given, by the last part of its name."""
    with pytest.raises(ConfigError) as error:
        kind.from_mapping(values)
    first = next(iter(values))
    assert first.rpartition('.')[2] in str(error.value)
    assert '\n' not in str(error.value)
