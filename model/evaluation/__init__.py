"""Matching, joint metrics, executability, reports."""
