"""The model of a camera, a pinhole or a fisheye, as its parameters ask for it."""

from __future__ import annotations

from lunar_rover_sim.camera.config import FurtherCameraConfig
from lunar_rover_sim.camera.fisheye import FisheyeCamera
from lunar_rover_sim.camera.hazard_config import HazardCameraConfig
from lunar_rover_sim.camera.rig import PinholeCamera


def geometry_of(config: FurtherCameraConfig) -> PinholeCamera | FisheyeCamera:
    """Return where a camera images what."""
    camera = config.camera
    return (FisheyeCamera(camera) if isinstance(camera, HazardCameraConfig) and camera.is_fisheye
            else PinholeCamera(camera))
