"""Studies that compare the simulator with theory: what `validate` and `calibrate` run."""
