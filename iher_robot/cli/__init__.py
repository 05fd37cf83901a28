"""Command line: parses options, calls the applications, prints results."""
