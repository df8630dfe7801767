"""Articulated objects made by rules, one file per family."""
