"""Speed benchmark of the parts of a training run against other libraries: `make bench`."""
