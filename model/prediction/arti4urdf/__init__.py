"""Arti4URDF: a language model that reads point-cloud tokens and writes a kinematic tree."""
