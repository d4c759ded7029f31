"""The camera: rig, reflectance, sunlight, EGL renderer and image sensor."""
