"""Installed packages, and the command that installs a missing one here."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import sys
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from model.core.errors import ConfigurationError


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
