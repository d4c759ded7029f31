"""The lunar image: stereo rig, reflectance, sunlight, EGL renderer and image sensor."""
