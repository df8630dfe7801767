"""All predictors in one table: built-ins and plug-ins load the same way."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

from model.errors import ConfigurationError
from model.predictor import Predictor
from model.remote import is_backend

ENTRY_POINTS = "artiworld.predictors"
"""Entry-point group of plug-ins; each names a callable without arguments that gives a Predictor."""

DEFAULT = "geometric"


def _geometric() -> Predictor:
    from model.geometric.predictor import GeometricPredictor

    return GeometricPredictor()


BUILT_IN: dict[str, Callable[[], Predictor]] = {"geometric": _geometric}


def _table() -> dict[str, Callable[[], Predictor]]:
    table = dict(BUILT_IN)
    for point in entry_points(group=ENTRY_POINTS):
        # A plug-in may not take a built-in's name.
        table.setdefault(point.name, lambda point=point: point.load()())
    return table


def predictor_names() -> tuple[str, ...]:
    """Names that :func:`load_predictor` takes, built-ins first."""
    return tuple(_table())


def load_predictor(name: str = DEFAULT) -> Predictor:
    """The predictor called ``name``; the address of a backend is a name too.

    Raises:
        ConfigurationError: where there is none, naming those that are there.
    """
    if is_backend(name):
        from model.remote.http_predictor import HttpPredictor

        return HttpPredictor(name)
    table = _table()
    if name not in table:
        raise ConfigurationError(f"no predictor {name!r}; there are {', '.join(table)}")
    return table[name]()
