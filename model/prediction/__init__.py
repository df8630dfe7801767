"""The Predictor port and its implementations: geometry, Arti4URDF, a remote backend."""

DEFAULT = "hybrid"
"""Name of the default predictor: Arti4URDF beside geometry, with the weights in the repository."""
