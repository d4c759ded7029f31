"""The sensors of the rover: each is one module, and `registry.SENSORS` lists them."""
