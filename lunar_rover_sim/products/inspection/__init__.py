"""Checks of bags, pictures of them, and summaries."""
