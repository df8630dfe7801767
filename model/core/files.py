"""Files that are written completely or not at all; those that ship with ArtiWorld; weights."""

from __future__ import annotations

import errno
import hashlib
import itertools
import json
import secrets
import shutil
import tempfile
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from model.core.errors import InputFileError, no_space


def static_assets() -> Path:
    """The folder ``static_assets`` beside the packages."""
    return Path(__file__).resolve().parents[2] / "static_assets"


OLD = ".old"
"""Ends the name of a folder while another takes its place: ``.NAME.0123abcd.old``."""


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
        text = f"can't be written: {error.strerror or error}"
        raise no_space(path, error) or InputFileError(path, text, remedy) from error


@contextmanager
def draft_of(path: Path, whole: Callable[[Path], bool] = lambda _: False) -> Iterator[Path]:
    """A file or folder to make beside ``path``, which takes its place at the end of the block.

    Each draft has a name of its own, so any number of threads, processes and servers may write one
    place at once: it holds what one of them wrote, complete. Where the block raises, ``path`` stays
    as it was. A file, or an empty folder, is replaced in one step; a full folder is moved aside
    first.

    Args:
        whole: tells of a full folder at ``path`` whether it stays, and the draft is dropped, as
            when somebody else was first; may raise where it must not be there.

    Raises:
        NoSpaceError: where the disk is full.
    """
    draft = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield draft
        _take_place(draft, path, whole)
    except OSError as error:
        if (full := no_space(path, error)) is not None:
            raise full from error
        raise
    finally:
        if draft.is_dir():
            shutil.rmtree(draft, ignore_errors=True)
        else:
            draft.unlink(missing_ok=True)


def unnamed_file(folder: Path) -> BinaryIO:
    """Open a file on the disk of ``folder`` that is gone once it is closed."""
    return tempfile.TemporaryFile(dir=folder)


def _take_place(draft: Path, path: Path, whole: Callable[[Path], bool]) -> None:
    """Rename ``draft``; whatever fails, a folder that was at ``path`` is left.

    Who is killed between the two renames of a full folder leaves the old one beside it.
    """
    if not draft.is_dir():
        draft.replace(path)
        return
    old = path.with_name(f".{path.name}.{secrets.token_hex(4)}{OLD}")
    while True:
        try:
            draft.rename(path)
            break
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                with suppress(OSError):
                    old.rename(path)
                raise
        if whole(path):
            break
        shutil.rmtree(old, ignore_errors=True)  # moved aside before another one came
        with suppress(FileNotFoundError):  # others move it aside, too
            path.rename(old)
    shutil.rmtree(old, ignore_errors=True)


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


# -- published weights -----------------------------------------------------------------------------


def read_safetensors(path: Path) -> dict[str, Any]:
    """All tensors of a safetensors file by name, on the CPU.

    Raises:
        InputFileError: if the file is absent or damaged.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise InputFileError(path, "no such file", "give a complete folder of weights")
    try:
        return load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise InputFileError(path, f"is no safetensors file, or a damaged one ({error})") from error


def strict_load(module: Any, state: Mapping[str, Any], path: Path, *, dtype: Any = None) -> None:
    """Load ``state`` into ``module``; every name and shape must match, every number be finite.

    Args:
        module: a torch module; on the meta device the tensors of ``state`` become its own.
        state: tensors by name.
        path: where they come from, for the error.
        dtype: of the weights afterwards; None keeps the module's, or on the meta device the file's.

    Raises:
        InputFileError: naming what is missing, unknown, of another shape or not finite.
    """
    expected = module.state_dict()
    problems = _differences(expected, state)
    if problems:
        raise InputFileError(path, "; ".join(problems), "give weights of this architecture")
    broken = [n for n, v in state.items() if v.is_floating_point() and not v.isfinite().all()]
    if broken:
        raise InputFileError(path, f"numbers that are not finite in {_some(broken)}")
    if dtype is not None:
        state = {n: v.to(dtype) if v.is_floating_point() else v for n, v in state.items()}
    on_meta = any(value.is_meta for value in expected.values())
    module.load_state_dict(state, strict=True, assign=on_meta)
    if dtype is not None:
        module.to(dtype)


def _differences(expected: Mapping[str, Any], state: Mapping[str, Any]) -> list[str]:
    missing = [name for name in expected if name not in state]
    unknown = [name for name in state if name not in expected]
    other = [
        f"{name} {list(state[name].shape)} instead of {list(value.shape)}"
        for name, value in expected.items()
        if name in state and state[name].shape != value.shape
    ]
    kinds = (("missing", missing), ("unknown", unknown), ("of another shape:", other))
    return [f"{kind} {_some(names)}" for kind, names in kinds if names]


def _some(names: Iterable[str], shown: int = 4) -> str:
    names = list(names)
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return ", ".join(names[:shown]) + more
