"""Benchmarks: speed, memory, latency and accuracy; one file per measurement."""
