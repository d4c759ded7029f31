"""Leg phases: shaping function, phase generator and leg controller, as functions of state."""
