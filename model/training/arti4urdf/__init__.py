"""Training of Arti4URDF: labels, samples, the loop."""
