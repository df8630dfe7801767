"""All scene readers in one table: built-ins and plug-ins load the same way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from model.core.errors import InputFileError
from model.core.packages import Registry
from model.io.formats.loaded import size_of
from model.scenes.scene import Scene, SceneProblem, SceneReader

FAR_APART = 30.0
"""Metres from most objects to their nearest neighbour; a room's stand within a few."""
_HEAD = 2**16


SCENE_READERS = Registry[SceneReader](
    "scene format",
    SceneReader,
    "name, description, recognises and read",
    {
        "artiworld": "model.scenes.native_format:OwnReader",
        "lisdf": "model.scenes.readers.lisdf:LisdfReader",
        "holodeck": "model.scenes.readers.houses:HolodeckReader",
        "mesatask": "model.scenes.readers.layouts:MesaTaskReader",
        "internscenes": "model.scenes.readers.layouts:InternScenesReader",
        "optiscene": "model.scenes.readers.layouts:OptiSceneReader",
        "physcene": "model.scenes.readers.houses:PhySceneReader",
        "gltf": "model.scenes.readers.gltf_usd:GltfSceneReader",
        "usd": "model.scenes.readers.gltf_usd:UsdStageReader",
        "scan": "model.scenes.readers.scan_room:ScanRoomReader",
    },
    group="artiworld.scene_readers",
)
"""All scene formats, in the order in which they are asked whether a file is theirs."""


def reader_names() -> tuple[str, ...]:
    """Names that :func:`load_reader` takes, built-ins first."""
    return SCENE_READERS.names()


def load_reader(name: str) -> SceneReader:
    """The reader of a scene format; see :meth:`~model.core.packages.Registry.load`."""
    return SCENE_READERS.load(name)


def recognised(path: Path) -> bool:
    """True if the file is a scene of a known format.

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
    message = (
        f"its objects stand {near:.0f} m from one another: are their places in millimetres or "
        "centimetres? Metres are taken"
    )
    note = SceneProblem(scene.path.name, message, skipped=False)
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
