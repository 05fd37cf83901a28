"""Many training runs as one experiment: what is run, how, and what came out of it."""
