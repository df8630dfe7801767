"""Values that every layer shares: meshes, clouds, assets, joints, trees; errors and progress."""
