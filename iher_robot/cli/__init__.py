"""Command line: parse options, call the applications, print results."""
