"""How fast the parts of a training run are, each in turn with its rivals: `make bench`."""
