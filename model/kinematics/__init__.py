"""Joints, kinematic trees, poses, URDF, contact and motion sweeps."""
