"""All predictors in one table: built-ins and plug-ins load the same way."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from model.core.errors import ConfigurationError
from model.prediction.remote import is_backend

if TYPE_CHECKING:  # the command line asks for names alone
    from importlib.metadata import EntryPoint

    from model.prediction.protocol import Predictor

ENTRY_POINTS = "artiworld.predictors"
"""Entry-point group of plug-ins; each names a callable without arguments that gives a Predictor."""

DEFAULT = "hybrid"
"""Arti4URDF with geometry beside it, on the weights that come with the repository."""

SMALL_MODELS = ("hybrid", "arti4urdf")
"""Names that also take a folder of the small model's weights: ``hybrid:FOLDER``."""

FULL_MODELS = {"qwen3": "local", "qwen3-vllm": "vllm"}
"""Names that take a folder of weights, and the engine that writes their answers."""


def _geometric() -> Predictor:
    from model.prediction.geometric.predictor import GeometricPredictor

    return GeometricPredictor()


@lru_cache(maxsize=2)
def _small_predictor(name: str, folder: Path | None = None) -> Predictor:
    from model.prediction.arti4urdf.predictor import HybridSettings, load_arti4urdf

    return load_arti4urdf(folder, name=name, hybrid=HybridSettings() if name == "hybrid" else None)


BUILT_IN: dict[str, Callable[[], Predictor]] = {
    "hybrid": lambda: _small_predictor("hybrid"),
    "arti4urdf": lambda: _small_predictor("arti4urdf"),
    "geometric": _geometric,
}


def _table() -> dict[str, Callable[[], Predictor]]:
    from importlib.metadata import entry_points  # the command line wants the default's name alone

    table = dict(BUILT_IN)
    for point in entry_points(group=ENTRY_POINTS):
        # A plug-in may not take a built-in's name.
        table.setdefault(point.name, lambda point=point: _plug_in(point))
    return table


def _plug_in(point: EntryPoint) -> Predictor:
    from model.core.plug_ins import load_plug_in
    from model.prediction.protocol import Predictor

    return load_plug_in(point, "predictor", Predictor, "name and predict")


def predictor_names() -> tuple[str, ...]:
    """Names that :func:`load_predictor` takes, built-ins first."""
    return tuple(_table())


def load_predictor(name: str = DEFAULT) -> Predictor:
    """The predictor called ``name``.

    The address of a backend is a name too, and so are ``qwen3:FOLDER``, the paper-size model with
    the weights in that folder, and ``hybrid:FOLDER``, the small one with weights of one's own.

    Raises:
        ConfigurationError: where there is none, naming those that are there, or where a plug-in
            can't be loaded or is no predictor.
    """
    check_predictor(name)
    if is_backend(name):
        from model.prediction.remote.http_predictor import HttpPredictor

        return HttpPredictor(name)
    kind, colon, folder = name.partition(":")
    if colon and kind in FULL_MODELS:
        return _full_predictor(Path(folder), FULL_MODELS[kind])
    if colon and kind in SMALL_MODELS:
        return _small_predictor(kind, Path(folder))
    return _table()[name]()


def check_predictor(name: str) -> None:
    """Raise where no predictor is called ``name``, without loading it.

    Raises:
        ConfigurationError: naming those that are there.
    """
    kind, colon, folder = name.partition(":")
    if is_backend(name) or (colon and folder and kind in (*FULL_MODELS, *SMALL_MODELS)):
        return
    table = _table()
    if name not in table:
        known = ", ".join([*table, *(f"{k}:FOLDER" for k in (*FULL_MODELS, *SMALL_MODELS))])
        raise ConfigurationError(f"no predictor {name!r}; there are {known}")


# Its weights are gigabytes: a worker keeps them.
@lru_cache(maxsize=1)
def _full_predictor(folder: Path, engine: str) -> Predictor:
    from model.prediction.arti4urdf.full_predictor import load_full_predictor

    return load_full_predictor(folder, engine=engine)
