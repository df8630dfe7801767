"""Articulated objects made by rules: modules, families made of them, composites, corruption."""
