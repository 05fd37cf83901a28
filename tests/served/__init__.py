"""Helpers of tests that use a robot behind a host: the host, clients, bad links, bad messages."""
