"""Data sets: many randomised runs from one file, checked, exported, described."""
