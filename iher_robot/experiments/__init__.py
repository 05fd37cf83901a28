"""Experiments: grids and searches of training runs, their execution and their reports."""
