"""Pointer, keys and commands."""
