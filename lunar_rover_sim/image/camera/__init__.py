"""Cameras: stereo rig, lens distortion, exposure, image sensor."""
