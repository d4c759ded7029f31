"""Evaluation of estimated trajectories against the truth."""
