"""What every wing stands on: parameters, topics, files, errors, frames, time, threads."""
