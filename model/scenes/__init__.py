"""Whole scenes: read, find what can be articulated, convert, put back where it stood, write."""
