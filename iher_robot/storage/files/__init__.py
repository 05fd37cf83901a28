"""File primitives: atomic writes, checksums, locks, SQLite, torch files."""
