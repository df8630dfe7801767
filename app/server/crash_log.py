"""Log files of crashes."""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
import traceback
from datetime import UTC, datetime
from pathlib import Path

_SECRET = ("token", "database", "password", "secret", "api-key")
"""Endings of the options whose values are secret."""
_LOGIN = re.compile(r"://[^/\s?#]*@")


def crash_folder() -> Path:
    """Return ``$XDG_STATE_HOME/artiworld``, by default ``~/.local/state/artiworld``."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "artiworld"


def write_crash(error: BaseException) -> Path:
    """Write the traceback of ``error`` into a file of its own and return the file.

    Tokens and passwords given on the command line are left out.
    """
    now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    lines = [
        f"{now} UTC, Python {platform.python_version()}, {platform.platform()}",
        "arguments: " + " ".join(_without_secrets(sys.argv[1:])),
        _without_login("".join(traceback.format_exception(error))),
        _without_login(getattr(error, "details", "")),
    ]
    for folder in (crash_folder(), Path(tempfile.gettempdir())):
        path = folder / f"artiworld-{now}-{os.getpid()}.log"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text("\n".join(lines))
        except OSError:
            continue
        return path
    return Path(os.devnull)


def _without_secrets(words: list[str]) -> list[str]:
    out: list[str] = []
    for i, word in enumerate(words):
        name, separator, _ = word.partition("=")
        if i and _is_secret(words[i - 1]):
            out.append("…")
        elif separator and _is_secret(name):
            out.append(f"{name}=…")
        else:
            out.append(_without_login(word))
    return out


def _is_secret(option: str) -> bool:
    return option.startswith("--") and option.endswith(_SECRET)


def _without_login(text: str) -> str:
    """Return the text with its URLs stripped of names and passwords."""
    return _LOGIN.sub("://…@", text)
