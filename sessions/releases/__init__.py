"""Data sets for other people: frozen, numbered, checksummed sets of accepted assets."""
