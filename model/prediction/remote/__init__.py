"""Prediction on another machine: the wire format and the client."""

TOKEN_VARIABLE = "ARTIWORLD_BACKEND_TOKEN"
"""Environment variable with the backend's token, which keeps it out of process lists."""


def is_backend(name: str) -> bool:
    """True if a predictor's name is the address of a backend."""
    return name.startswith(("http://", "https://"))
