"""The picture in 3D."""
