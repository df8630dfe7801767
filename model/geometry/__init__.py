"""Points, meshes, assets: reading, sampling, picking, splitting, writing."""
