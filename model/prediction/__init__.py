"""The Predictor port and those who answer it: geometry, Arti4URDF, a remote backend."""
