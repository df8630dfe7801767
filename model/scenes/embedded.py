"""Scenes whose file holds the geometry of their objects."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from model.core.files import draft_of
from model.core.textures import one_reading
from model.scenes.assets import asset_digest
from model.scenes.protocol import SceneReader
from model.scenes.registry import load_reader
from model.scenes.scene import Scene
from model.scenes.unpacking import Unpacked


@runtime_checkable
class GeometryReader(SceneReader, Protocol):
    """A reader of files that hold geometry."""

    def unpack(self, scene: Scene, folder: Path) -> Unpacked:
        """Write each object's geometry below ``folder`` in the frame of its asset: metres, +z up,
        before ``scale``. The same file gives the same bytes.

        Raises:
            InputFileError: where the file as a whole can't be read any more.
        """
        ...


@one_reading()
def unpack(scene: Scene, folder: Path) -> Unpacked:
    """The assets inside the scene's file; none for a scene that only names them.

    Args:
        folder: replaced where it differs.

    Raises:
        InputFileError: where the file can't be read any more, or the folder not written.
    """
    reader = _geometry_reader(scene)
    if reader is None:
        return Unpacked()
    with draft_of(folder, lambda there: asset_digest(there) == asset_digest(draft)) as draft:
        draft.mkdir()
        found = reader.unpack(scene, draft)
    places = {asset: folder / path.relative_to(draft) for asset, path in found.files.items()}
    problems = {a: p.replace(str(draft), str(folder)) for a, p in found.problems.items()}
    return Unpacked(places, problems)


def holds_geometry(scene: Scene) -> bool:
    """True if the scene's own file holds the assets."""
    return _geometry_reader(scene) is not None


def _geometry_reader(scene: Scene) -> GeometryReader | None:
    reader = load_reader(scene.reader)
    return reader if isinstance(reader, GeometryReader) else None
