"""Labelled clouds and rooms made from procedural shapes, for training segmenters."""
