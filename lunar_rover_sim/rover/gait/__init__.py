"""The gait: phases of the legs, their shaping function, the controller and its calibration."""
