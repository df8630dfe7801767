"""Files that are written completely or not at all, their names and the user's errors."""

from __future__ import annotations

import hashlib
import itertools
import json
import secrets
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def free_name(name: str, taken: Container[str]) -> str:
    """``name``, or with the first number from 2 on that isn't taken: ``door_2``."""
    free = name
    for number in itertools.count(2):
        if free not in taken:
            break
        free = f"{name}_{number}"
    return free


@contextmanager
def written_to(path: Path, remedy: str = "") -> Iterator[None]:
    """Turn failures to write within the block into errors that name ``path``.

    Raises:
        InputFileError: where the system can't write.
    """
    try:
        yield
    except OSError as error:
        raise InputFileError(
            path, f"can't be written: {error.strerror or error}", remedy
        ) from error


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """A file beside ``path`` that replaces it at the end of the block, unless that raises."""
    draft = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def write_json(path: Path, value: Any, *, indent: int = 2, allow_nan: bool = False) -> None:
    """Write ``value`` completely or not at all.

    Args:
        allow_nan: whether it may hold NaN and infinity, as a source that is written back.

    Raises:
        InputFileError: where the folder can't be written.
    """
    with written_to(path), draft_of(path) as draft:
        text = json.dumps(value, indent=indent, ensure_ascii=False, allow_nan=allow_nan) + "\n"
        draft.write_bytes(text.encode("utf-8", "backslashreplace"))  # lone surrogates: \ud800


def read_json(path: Path, remedy: str = "") -> Any:
    """The JSON value in ``path``.

    Raises:
        InputFileError: where it can't be read or isn't JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputFileError(path, error.strerror or "can't be read", remedy) from None
    except (ValueError, RecursionError) as error:
        raise InputFileError(path, f"is not JSON: {error}", remedy) from None
