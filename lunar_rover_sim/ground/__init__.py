"""The Moon: terrain as a world folder, and regolith that gives."""
