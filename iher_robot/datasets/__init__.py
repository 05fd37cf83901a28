"""Data of finished and running runs: inspect, verify, export."""
