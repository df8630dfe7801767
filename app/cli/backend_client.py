"""The side of the commands that predict with an ArtiWorld backend."""

from __future__ import annotations

import os
import sys

from app.cli.options import PredictorOptions
from model.core.errors import ConfigurationError
from model.prediction import TOKEN_VARIABLE, is_backend
from model.prediction.registry import DEFAULT
from model.prediction.remote_backend import BackendError, BackendRefused, HttpPredictor


def chosen_predictor(options: PredictorOptions) -> str:
    """The predictor's name, or the backend's address.

    The token goes into the environment, where worker processes find it.

    Raises:
        ConfigurationError: where both a backend and another predictor are given, or the address
            can't be one.
    """
    url = options.backend
    if url is None and is_backend(options.predictor):
        url = options.predictor
    if url is None:
        if options.backend_token:
            raise ConfigurationError("a backend's token is given, but no --backend")
        return options.predictor
    if options.predictor not in (DEFAULT, url):
        raise ConfigurationError(
            f"--backend and --predictor {options.predictor} exclude each other: "
            "the backend has its own"
        )
    if options.backend_token:
        os.environ[TOKEN_VARIABLE] = options.backend_token
    return HttpPredictor(url).url


def check_backend(url: str) -> None:
    """Warn on stderr where a backend can't be reached yet; predictions fail until it can.

    Raises:
        BackendRefused: where it refuses the token.
    """
    try:
        HttpPredictor(url, connect_seconds=3.0, silence_seconds=3.0).check()
    except BackendRefused:
        raise
    except BackendError as error:
        print(f"artiworld: {error}; the app asks again at every prediction", file=sys.stderr)
