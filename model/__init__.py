"""What the machine infers: geometry, segmentation, kinematics, prediction, export.

Imports neither ``sessions`` nor ``app``.
"""
