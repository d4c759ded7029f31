"""Judging an estimated trajectory against the truth."""
