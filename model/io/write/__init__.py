"""Writing meshes and clouds."""
