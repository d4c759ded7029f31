"""Judging estimates against the truth."""
