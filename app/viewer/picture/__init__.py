"""What is drawn in 3D."""
