"""Files as users write them and as commands leave them: YAML, packaged resources, whole files."""
