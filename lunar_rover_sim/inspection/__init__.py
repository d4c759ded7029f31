"""Whether a bag can be trusted, and what it looks like."""
