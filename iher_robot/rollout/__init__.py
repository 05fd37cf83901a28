"""Episodes on a robot: run, record and charge them."""
