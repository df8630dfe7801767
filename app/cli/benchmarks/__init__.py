"""Figures that are measured on this machine."""
