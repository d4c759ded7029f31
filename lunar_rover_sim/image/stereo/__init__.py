"""Stereo: semi-global matching, disparity and depth, error against truth."""
