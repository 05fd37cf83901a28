"""Episodes in several simulator processes at once."""
