"""Leg phases: shaping function, phase generator and leg controller, as pure functions of state."""
