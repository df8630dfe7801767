"""Masks that a person asks for by other means than clicks."""
