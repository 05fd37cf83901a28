"""Typed settings of runs and robots, and the YAML files they come from."""
