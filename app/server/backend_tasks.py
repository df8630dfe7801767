"""Jobs of a backend's worker processes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.progress import Progress, no_progress
from model.prediction.registry import Predictor, load_predictor
from model.prediction.remote_backend import decode_request, encode_answer

_loaded: list[Predictor] = []


def load(name: str) -> None:
    """Load the predictor: the initializer of a worker."""
    _loaded[:] = [load_predictor(name)]


def ready() -> str:
    """Return the name of the loaded predictor."""
    return _loaded[0].name


def predict(body: npt.NDArray[np.uint8], progress: Progress = no_progress) -> dict[str, Any]:
    """Predict for the bytes of a request.

    Raises:
        ArtiworldError: where they are malformed.
    """
    progress(0.0, "Reading the parts")
    segmented, locked, seed = decode_request(body.tobytes())
    answer = _loaded[0].predict(segmented, locked=locked, seed=seed, progress=progress)
    return encode_answer(answer)
