"""Typed settings of runs and robots, read from YAML files."""
