"""All scene readers in one table: built-ins and plug-ins load the same way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from model.core.errors import ConfigurationError, InputFileError
from model.core.plug_ins import load_plug_in
from model.io.formats.loaded import size_of
from model.scenes.protocol import SceneReader
from model.scenes.scene import Scene, SceneProblem

ENTRY_POINTS = "artiworld.scene_readers"
"""Entry-point group of plug-ins; each names a callable without arguments that gives a reader."""

FAR_APART = 30.0
"""Metres from most objects to their nearest neighbour; a room's stand within a few."""
_HEAD = 2**16


def _own() -> SceneReader:
    from model.scenes.readers.own import OwnReader

    return OwnReader()


def _lisdf() -> SceneReader:
    from model.scenes.readers.lisdf import LisdfReader

    return LisdfReader()


def _holodeck() -> SceneReader:
    from model.scenes.readers.holodeck import HolodeckReader

    return HolodeckReader()


def _mesatask() -> SceneReader:
    from model.scenes.readers.mesatask import MesaTaskReader

    return MesaTaskReader()


def _internscenes() -> SceneReader:
    from model.scenes.readers.internscenes import InternScenesReader

    return InternScenesReader()


def _optiscene() -> SceneReader:
    from model.scenes.readers.optiscene import OptiSceneReader

    return OptiSceneReader()


def _gltf() -> SceneReader:
    from model.scenes.readers.gltf_scene import GltfSceneReader

    return GltfSceneReader()


def _usd() -> SceneReader:
    from model.scenes.readers.usd_stage import UsdStageReader

    return UsdStageReader()


def _scan() -> SceneReader:
    from model.scenes.readers.scan_room import ScanRoomReader

    return ScanRoomReader()


BUILT_IN: dict[str, Callable[[], SceneReader]] = {
    "artiworld": _own,
    "lisdf": _lisdf,
    "holodeck": _holodeck,
    "mesatask": _mesatask,
    "internscenes": _internscenes,
    "optiscene": _optiscene,
    "gltf": _gltf,
    "usd": _usd,
    "scan": _scan,
}


def _table() -> dict[str, Callable[[], SceneReader]]:
    table = dict(BUILT_IN)
    for point in entry_points(group=ENTRY_POINTS):
        # A plug-in may not take a built-in's name.
        needs = "name, description, recognises and read"
        made = partial(load_plug_in, point, "scene reader", SceneReader, needs)
        table.setdefault(point.name, made)
    return table


def reader_names() -> tuple[str, ...]:
    """Names that :func:`load_reader` takes, built-ins first."""
    return tuple(_table())


def load_reader(name: str) -> SceneReader:
    """The reader called ``name``.

    Raises:
        ConfigurationError: where there is none, naming those that are there.
    """
    table = _table()
    if name not in table:
        raise ConfigurationError(f"no scene format {name!r}; there are {', '.join(table)}")
    return table[name]()


def recognised(path: Path) -> bool:
    """Whether the file is a scene of a known format.

    Raises:
        InputFileError: where it can't be read.
    """
    head = _head(path)
    return any(load_reader(name).recognises(path, head) for name in reader_names())


def read_scene(path: str | Path, format: str | None = None) -> Scene:
    """Read a scene.

    Args:
        path: the file.
        format: name of the reader; by default the first that recognises the file.

    Raises:
        InputFileError: where nobody recognises the file or it can't be read.
        ConfigurationError: for an unknown format.
    """
    path = Path(path)
    if format is not None:
        return _checked(load_reader(format).read(path))
    head = _head(path)
    for name in reader_names():
        reader = load_reader(name)
        if reader.recognises(path, head):
            return _checked(reader.read(path))
    raise InputFileError(
        path,
        "is no scene of a known format",
        f"known are {', '.join(reader_names())}; name one with --format",
    )


def _checked(scene: Scene) -> Scene:
    """With a note where objects stand so far apart that their places can't be metres."""
    at = np.array([o.world_from_object[:3, 3] for o in scene.objects]).reshape(-1, 3)
    if len(at) < 3:
        return scene
    near = float(np.median(KDTree(at).query(at, k=2)[0][:, 1]))
    sizes = [max(o.fit or o.box or (0.0,)) for o in scene.objects]
    if near < max(FAR_APART, 4 * max(sizes)):
        return scene
    told = (
        f"its objects stand {near:.0f} m from one another: are their places in millimetres or "
        "centimetres? Metres are taken"
    )
    note = SceneProblem(scene.path.name, told, skipped=False)
    return replace(scene, problems=(*scene.problems, note))


def _head(path: Path) -> bytes:
    if path.is_dir():
        raise InputFileError(path, "is a folder", "name the scene's file")
    size_of(path)  # a pipe would never be read to its end
    try:
        with path.open("rb") as file:
            return file.read(_HEAD)
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}", "check the path") from None
