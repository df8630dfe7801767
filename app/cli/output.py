"""Checks of output folders before a command writes."""

from __future__ import annotations

import os
from pathlib import Path

from model.core.errors import ConfigurationError


def check_output(out: Path, *inputs: Path, option: str = "--out") -> None:
    """Check that ``out`` can be an output folder and would not overwrite an input.

    Args:
        option: the option that names the folder.

    Raises:
        ConfigurationError: with what to do.
    """
    try:
        taken = out.exists() and not out.is_dir()
    except (OSError, ValueError) as error:  # a name that is too long or has a NUL
        why = getattr(error, "strerror", None) or error
        raise ConfigurationError(
            f"{option} {str(out)[:80]}… can't be a folder ({why}); give another name"
        ) from error
    if taken:
        raise ConfigurationError(f"{option} {out} is a file; give a folder")
    for source in inputs:
        if os.path.realpath(out) == os.path.realpath(source):  # pathlib raises on circular links
            raise ConfigurationError(f"{option} {out} is where the input is; give another folder")
    above = next((p for p in (out, *out.absolute().parents) if p.exists()), Path("/"))
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise ConfigurationError(f"{option} {out} can't be written; choose a folder of your own")


def other_files_error(out: Path) -> ConfigurationError:
    """The error for an output folder that holds something else than an earlier result."""
    return ConfigurationError(f"--out {out} holds other files; give a new or an empty folder")
