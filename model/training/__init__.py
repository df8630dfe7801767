"""Training of the segmenter and of Arti4URDF."""
