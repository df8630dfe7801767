"""Promptable part segmentation: encode once, answer each click."""
