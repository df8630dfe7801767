"""Loading what other packages offer under our entry-point groups."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from model.core.errors import ArtiworldError, ConfigurationError


def load_plug_in(point: EntryPoint, kind: str, port: type, needs: str) -> Any:
    """What the callable of an entry point gives.

    Args:
        point: names a callable without arguments.
        kind: what a plug-in of its group is, as errors call it.
        port: the protocol that it has to fit.
        needs: the members of ``port``, as errors name them.

    Raises:
        ConfigurationError: where its module can't be imported, hasn't got the callable, or its
            call fails or gives something that doesn't fit.
    """
    try:
        made = point.load()()
    except ArtiworldError:  # it says itself what it lacks
        raise
    except Exception as error:  # somebody else's plug-in may fail in any way
        told = isinstance(error, ImportError | AttributeError)
        why = str(error) if told else f"{type(error).__name__}: {error}"
        raise ConfigurationError(
            f"the {kind} {point.name!r} can't be loaded: {why}; mend or remove its package"
        ) from error
    # A class has all its methods, but they can't be called on it.
    if isinstance(made, port) and not isinstance(made, type):
        return made
    gave = f"the class {made.__name__}" if isinstance(made, type) else f"a {type(made).__name__}"
    raise ConfigurationError(
        f"the plug-in {point.name!r} ({point.value}) gives {gave}, which is no {kind}: "
        f"it needs {needs}; mend or remove its package"
    )
