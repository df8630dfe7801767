"""Optional packages, and plug-ins.

A missing package is named with the command that installs it here. One table a kind of plug-in:
built-ins and entry points load the same way.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from typing import Any, Generic, TypeVar

from model.core.errors import ArtiworldError, ConfigurationError


def install_command(*requirements: str) -> str:
    """The line that installs ``requirements`` here, to be copied into a shell.

    ``pip install …`` where that pip is this environment's, else this Python's own: after
    ``make run`` the environment is not activated, and another pip knows no package of this name.
    """
    folder = os.path.dirname(os.path.abspath(sys.executable))
    pip = shutil.which("pip")
    if pip is not None and os.path.dirname(os.path.abspath(pip)) == folder:
        start = "pip"
    else:
        python = os.path.join(folder, os.path.basename(sys.executable))
        near = os.path.relpath(python)
        start = f"{shlex.quote(python if near.startswith(os.pardir) else near)} -m pip"
    return f"{start} install {' '.join(map(shlex.quote, requirements))}"


def installed_versions(*packages: str) -> dict[str, str]:
    """Versions of Python and of those of ``packages`` that are installed."""
    out = {"python": platform.python_version()}
    for package in packages:
        with suppress(PackageNotFoundError):
            out[package] = version(package)
    return out


def require(module: str, extra: str, what: str = "this") -> Any:
    """Import an optional package's module; ``what`` needs it, for the message.

    Raises:
        ConfigurationError: with the command that installs it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        missing = f"{what} needs {module.partition('.')[0]}, which isn't installed"
        raise ConfigurationError(f"{missing}: {install_command(extra)}") from error


T = TypeVar("T")


def at_place(place: str) -> Any:
    """Object that ``"package.module:name"`` refers to, imported now.

    Raises:
        ImportError: where it can't be.
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


@dataclass(frozen=True)
class Registry(Generic[T]):
    """Named implementations of one protocol.

    A built-in is written as ``"package.module:callable"`` and imported when it is asked for, so
    that a table costs nothing to read. A plug-in can't take a built-in's name.

    Attributes:
        kind: what an entry is, as errors call it: "segmenter".
        protocol: what every entry fits; it is checked at run time.
        members: of the protocol, as errors name them: "name and encode".
        built_in: name → where its factory is.
        group: the entry-point group of plug-ins, or None; each names a callable that takes what
            :meth:`load` is given beside the name.
        parametrised: KIND → where the factory of ``KIND:ARGUMENT`` is.
        argument: what stands for the argument in messages: "FOLDER".
    """

    kind: str
    protocol: type
    members: str
    built_in: Mapping[str, str | Callable[..., T]]
    group: str | None = None
    parametrised: Mapping[str, str | Callable[..., T]] = field(default_factory=dict)
    argument: str = "FOLDER"

    def names(self) -> tuple[str, ...]:
        """Names that :meth:`load` takes without an argument, built-ins first."""
        return tuple(dict.fromkeys([*self.built_in, *self._plug_ins()]))

    def check(self, name: str) -> None:
        """Refuse a name that :meth:`load` doesn't know, without loading anything.

        Raises:
            ConfigurationError: naming those that are there.
        """
        start, _, argument = name.partition(":")
        if name in self.built_in or (argument and start in self.parametrised):
            return
        if name not in self._plug_ins():
            known = [*self.names(), *(f"{k}:{self.argument}" for k in self.parametrised)]
            raise ConfigurationError(f"no {self.kind} {name!r}; there are {', '.join(known)}")

    def load(self, name: str, /, *arguments: Any, **options: Any) -> T:
        """The entry called ``name``.

        Args:
            name: one of :meth:`names`, or ``KIND:ARGUMENT``.
            arguments, options: for the factory.

        Raises:
            ConfigurationError: for an unknown name, or one that can't be loaded here.
        """
        self.check(name)
        if name in self.built_in:
            return self._made(name, self.built_in[name], *arguments, **options)
        start, colon, argument = name.partition(":")
        if colon and start in self.parametrised:
            return self._made(name, self.parametrised[start], argument, *arguments, **options)
        return self._plugged(self._plug_ins()[name], *arguments, **options)

    def _plug_ins(self) -> dict[str, EntryPoint]:
        return {} if self.group is None else {p.name: p for p in entry_points(group=self.group)}

    def _made(
        self, name: str, factory: str | Callable[..., T], /, *arguments: Any, **options: Any
    ) -> T:
        try:
            made = at_place(factory) if isinstance(factory, str) else factory
            return made(*arguments, **options)
        except ImportError as error:  # an extra isn't installed
            raise ConfigurationError(f"{self.kind} {name!r} can't be loaded: {error}") from error

    def _plugged(self, point: EntryPoint, *arguments: Any, **options: Any) -> T:
        try:
            made = point.load()(*arguments, **options)
        except ArtiworldError:  # its message names what is missing
            raise
        except Exception as error:  # a plug-in may raise anything
            plain = isinstance(error, ImportError | AttributeError)
            why = str(error) if plain else f"{type(error).__name__}: {error}"
            raise ConfigurationError(
                f"{self.kind} {point.name!r} can't be loaded: {why}; fix or remove its package"
            ) from error
        # A class passes the protocol check, but its methods need an instance.
        if isinstance(made, self.protocol) and not isinstance(made, type):
            return made
        kind = type(made).__name__
        gave = f"the class {made.__name__}" if isinstance(made, type) else f"a {kind}"
        raise ConfigurationError(
            f"the plug-in {point.name!r} ({point.value}) gives {gave}, which is no {self.kind}: "
            f"it needs {self.members}; fix or remove its package"
        )
