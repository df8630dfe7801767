"""Segmenters scored by simulated clicks."""
