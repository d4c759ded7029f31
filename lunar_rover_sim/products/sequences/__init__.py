"""Sequences for SLAM programs and trainers (`export.FORMATS` lists them), and settings files."""
