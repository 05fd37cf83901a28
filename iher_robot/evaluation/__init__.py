"""Evaluation of a policy: success rate, film, viewer, policy files."""
