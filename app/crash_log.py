"""Where the details of our own faults go."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import traceback
from datetime import UTC, datetime
from pathlib import Path


def crash_folder() -> Path:
    """``$XDG_STATE_HOME/artiworld``, by default ``~/.local/state/artiworld``."""
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
        "".join(traceback.format_exception(error)),
        getattr(error, "details", ""),
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
        name = word.partition("=")[0]
        if i and words[i - 1] in ("--token", "--database"):
            out.append("…")
        elif "=" in word and name in ("--token", "--database"):
            out.append(f"{name}=…")
        else:
            out.append(word)
    return out
