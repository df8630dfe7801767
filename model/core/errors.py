"""Errors that a user can cause. Each message names the file or value and says what would be right.

The command line answers any :class:`ArtiworldError` with exit code 2 and its one-line message;
everything else is an internal error (exit code 1).
"""

from __future__ import annotations

import errno
from pathlib import Path


class ArtiworldError(Exception):
    """Base of every error that comes from the user's input."""


class InputFileError(ArtiworldError):
    """A file that can't be used.

    Args:
        path: the file.
        problem: what is wrong with it.
        remedy: what would be right.
    """

    def __init__(self, path: str | Path, problem: str, remedy: str = "") -> None:
        self.path = Path(path)
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{path}: {problem}" + (f"; {remedy}" if remedy else ""))


class StoreError(ArtiworldError):
    """The workspace or its database can't be used (newer format, damaged file, no permission)."""


class NoSpaceError(InputFileError, StoreError):
    """The disk has no room for what was to be written; nothing of it is left."""


def no_space(path: str | Path, error: OSError) -> NoSpaceError | None:
    """The error of a full disk, or of a limit on what is written; None for another one."""
    if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return None
    problem = f"can't be written: {error.strerror}"
    return NoSpaceError(path, problem, "check space: remove files there, then do it again")


class GeometryError(ArtiworldError):
    """Points or faces that break a contract (NaN, wrong shape, index out of range)."""


class KinematicsError(ArtiworldError):
    """A kinematic tree that is not one. ``problems`` holds every violation, not the first."""

    def __init__(self, problems: list[str] | tuple[str, ...]) -> None:
        self.problems = tuple(problems)
        super().__init__("; ".join(self.problems))


class PromptError(ArtiworldError):
    """Prompts that don't fit the object (a part that isn't there, NaN, an unknown element)."""


class ConfigurationError(ArtiworldError):
    """An option or a combination of options that can't work."""


class CommandError(ArtiworldError):
    """A session command that the current state doesn't allow."""
