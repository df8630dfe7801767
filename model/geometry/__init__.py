"""Algorithms on meshes and clouds: sampling, normals, picking, splitting, surfaces."""
