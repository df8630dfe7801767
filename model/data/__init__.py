"""Articulated objects with ground truth, behind one protocol."""
