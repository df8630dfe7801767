"""One function over many assets in worker processes; no failure or crash ends the batch."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from model.core.errors import ArtiworldError, InputFileError
from model.evaluation.pool import robust_map

T = TypeVar("T")

ASSET_FILES = ("object.urdf", "mobility.urdf", "object.xml", "model.sdf")
"""Files that mark a folder as an asset: ours, PartNet-Mobility's, exports to MJCF and SDF."""


class Crashed(RuntimeError):
    """A worker process ended without an answer."""


def find_assets(paths: Sequence[Path]) -> list[Path]:
    """Assets among ``paths``: URDF and MJCF files, asset folders, and folders of these.

    Raises:
        InputFileError: for a path with nothing of the kind.
    """
    out: list[Path] = []
    for path in paths:
        if path.is_file():
            found = [path]
        else:
            found = _in_folder(path)
            if not found and path.is_dir():
                found = [a for child in sorted(path.iterdir()) for a in _in_folder(child)]
        if not found and not path.exists():
            raise InputFileError(path, "no such file or folder", "check the path")
        if not found:
            raise InputFileError(
                path,
                "is no URDF, SDF, USD or MJCF and holds no object.urdf",
                "give assets or folders of assets",
            )
        out += found
    return list(dict.fromkeys(out))


def _in_folder(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    if (folder / ASSET_FILES[0]).is_file():
        return [folder]
    return [folder / name for name in ASSET_FILES[1:] if (folder / name).is_file()][:1]


def asset_names(assets: Sequence[Path]) -> list[str]:
    """A unique name for each: the folder's, or the file's where it has a name of its own."""
    out: list[str] = []
    for asset in assets:
        if asset.is_dir():
            base = asset.resolve().name
        else:
            base = asset.parent.resolve().name if asset.name in ASSET_FILES else asset.stem
        name, number = base, 2
        while name in out:
            name, number = f"{base}_{number}", number + 1
        out.append(name)
    return out


def run_all(
    function: Callable[[Any], T], tasks: Sequence[Any], jobs: int | None
) -> Iterator[tuple[int, T | Exception]]:
    """(index of the task, its answer or exception), in the order of completion.

    A task whose process dies twice, the second time alone, gives a :class:`Crashed`.

    Args:
        function: can be pickled.
        jobs: processes; None for as many as processors.
    """
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    numbered = [_Numbered(i, task) for i, task in enumerate(tasks)]
    for each, outcome in robust_map(partial(_outcome, function), numbered, jobs, "spawn"):
        if outcome is None:
            crash = Crashed("the worker process crashed (often because memory ran out)")
            yield each.index, crash
        else:
            yield each.index, outcome[0]


@dataclass(frozen=True, eq=False)
class _Numbered:
    """A task with its identity, as equal tasks may come twice."""

    index: int
    task: Any


def _outcome(function: Callable[[Any], T], numbered: _Numbered) -> tuple[T | Exception]:
    try:
        return (function(numbered.task),)
    except Exception as error:  # the boundary of a task
        return (error,)


def error_text(error: Exception) -> str:
    """Message of a failed task; internal errors are named by their type."""
    kind = "" if isinstance(error, ArtiworldError) else f"{type(error).__name__}: "
    return f"{kind}{error}"
