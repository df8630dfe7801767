"""The command that installs a missing package here; the shell's pip may be another one."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from importlib.util import find_spec

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


def require(package: str, extra: str) -> None:
    """Refuse to go on where an optional package isn't installed.

    Raises:
        ConfigurationError: with the command that installs it.
    """
    if find_spec(package) is None:
        how = install_command(extra)
        raise ConfigurationError(f"this needs the package {package}, which isn't installed: {how}")
