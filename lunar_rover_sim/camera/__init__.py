"""What a camera is: stereo rig, lens distortion, exposure, image sensor."""
