"""Describe proposed masks by features: border, shape, colour, fit to the clicks."""
