"""Studies that hold a part of the simulator to its theory: what `validate` and `calibrate` run."""
