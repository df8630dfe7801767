"""Loading what other packages offer under our entry-point groups."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from model.errors import ConfigurationError


def load_plug_in(point: EntryPoint, kind: str) -> Any:
    """What the callable of an entry point gives.

    Args:
        point: names a callable without arguments.
        kind: what a plug-in of its group is, as errors call it.

    Raises:
        ConfigurationError: where its module can't be imported or hasn't got the callable.
    """
    try:
        return point.load()()
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(
            f"the {kind} {point.name!r} can't be loaded: {error}; mend or remove its package"
        ) from error
