"""Files: YAML as users write it, packaged configuration, output folders, atomic writing."""
