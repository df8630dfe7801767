"""Whole scenes: read, find articulable objects, convert, place, write."""
