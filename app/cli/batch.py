"""One function over many objects in worker processes; one that fails or crashes ends nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from model.core.errors import InputFileError
from model.evaluation.pool import in_processes

T = TypeVar("T")

ASSET_FILES = ("object.urdf", "mobility.urdf", "object.xml")
"""What marks a folder as an asset: ours, PartNet-Mobility's, and our exports to MJCF."""


class Crashed(RuntimeError):
    """A worker process ended without an answer."""


def find_assets(paths: Sequence[Path]) -> list[Path]:
    """Assets among ``paths``: URDF and MJCF files, asset folders, and folders that hold such.

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
                "is no URDF or MJCF and holds no object.urdf",
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
    """A name for each that no other has: the folder's, for a file its folder's or its own."""
    out: list[str] = []
    for asset in assets:
        bare = asset.is_dir() or asset.name in ASSET_FILES
        base = name = (asset if asset.is_dir() else asset.parent).resolve().name if bare else (
            asset.stem
        )  # fmt: skip
        number = 2
        while name in out:
            name, number = f"{base}_{number}", number + 1
        out.append(name)
    return out


def run_all(
    function: Callable[[Any], T], tasks: Sequence[Any], jobs: int
) -> Iterator[tuple[int, T | Exception]]:
    """(number of the task, its answer or what it raised), as they come.

    A task that brings its process down is tried once more by itself; then it is a
    :class:`Crashed`.
    """
    if jobs <= 1 or len(tasks) == 1:
        for i, task in enumerate(tasks):
            yield i, _tried(function, task)
        return
    left = dict(enumerate(tasks))
    yield from _pool(function, left, jobs)
    while left:
        number = next(iter(left))
        alone = {number: left[number]}
        yield from _pool(function, alone, 1)
        if alone:
            yield number, Crashed("the worker process crashed (often because memory ran out)")
        del left[number]


def _pool(
    function: Callable[[Any], T], left: dict[int, Any], jobs: int
) -> Iterator[tuple[int, T | Exception]]:
    """Answers of what is in ``left``, from which the answered are taken."""
    with in_processes(partial(_tried, function), list(left.values()), jobs, "spawn") as futures:
        numbers = dict(zip(futures, list(left), strict=True))
        for future in as_completed(futures):
            try:
                answer = future.result()
            except BrokenProcessPool:
                continue
            del left[numbers[future]]
            yield numbers[future], answer


def _tried(function: Callable[[Any], T], task: Any) -> T | Exception:
    try:
        return function(task)
    except Exception as error:  # the boundary of a task
        return error
