"""Operator commands on a robot: deploy, doctor, home, stop, clear-fault."""
