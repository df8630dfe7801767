"""Scenes whose file holds geometry: each object is written as an asset of its own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from model.core.errors import ArtiworldError
from model.core.files import draft_of
from model.core.geometry import affine, axis_scales
from model.core.textures import one_reading
from model.io.formats.loaded import Loaded, join
from model.io.geometry_files import cleaned, is_solid, to_cloud, to_mesh
from model.io.model_files import OBJECT_JSON
from model.io.write import mesh_to_glb, write_cloud
from model.scenes.asset_parts import MOST_PIECES, asset_digest
from model.scenes.registry import load_reader
from model.scenes.scene import FloatArray, Scene, SceneObjectError, SceneReader

Pieces = Callable[[], Sequence[tuple[str | None, Loaded]]]
_RIGID = 1e-6


@dataclass(frozen=True)
class Unpacked:
    """Assets unpacked from a scene's file.

    Attributes:
        files: asset id → file, or folder of part meshes.
        problems: asset id → why there is none.
    """

    files: Mapping[str, Path] = field(default_factory=dict)
    problems: Mapping[str, str] = field(default_factory=dict)


def placed_frame(world: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pose, scale and what is left of an affine (4, 4) world_from_object.

    Returns:
        (4, 4) rigid pose, (3,) positive scale, and the (3, 3) map that the geometry needs before
        them: the identity, but for mirrors and shears.

    Raises:
        SceneObjectError: where it isn't finite, or squeezes the object flat.
    """
    if not np.isfinite(world).all():
        raise SceneObjectError("its transform holds numbers that are not finite")
    linear = world[:3, :3]
    scale = axis_scales(linear)
    if scale.min() < 1e-9 or abs(np.linalg.det(linear / max(scale.max(), 1e-300))) < 1e-12:
        raise SceneObjectError(f"its scale {scale.tolist()} leaves nothing of it")
    pose = affine(shift=world[:3, 3])
    turn = linear / scale
    if np.abs(turn @ turn.T - np.eye(3)).max() > _RIGID or np.linalg.det(turn) < 0:
        return pose, np.ones(3), linear.copy()
    pose[:3, :3] = turn
    return pose, scale, np.eye(3)


def write_object(folder: Path, stem: str, pieces: Sequence[tuple[str | None, Loaded]]) -> Path:
    """One object: a mesh file, a cloud, or a folder of part meshes where it has two to
    ``MOST_PIECES`` named pieces.

    Args:
        pieces: name and geometry in the asset's frame, metres, +z up.

    Raises:
        ArtiworldError: where there is no geometry, or it is damaged.
    """
    if not pieces:
        raise SceneObjectError("it has no geometry")
    target = folder / stem
    clean = [(n, cleaned(target, p, np.eye(4), 1.0)) for n, p in pieces if len(p.faces)]
    solid = [(n, p) for n, p in clean if is_solid(p)]  # none of a piece's faces may have an area
    if not solid:
        points = cleaned(target, join([p for _, p in pieces]), np.eye(4), 1.0)
        write_cloud(to_cloud(points), target.with_name(f"{stem}.ply"))
        return target.with_name(f"{stem}.ply")
    if not 2 <= len(solid) <= MOST_PIECES:
        whole = join([p for _, p in solid])
        return _write_glb(whole, target.with_name(f"{stem}.glb"))
    target.mkdir(exist_ok=True)
    entries = []
    for i, (name, piece) in enumerate(solid):
        _write_glb(piece, target / f"link_{i}.glb")
        entries.append({"file": f"link_{i}.glb", **({"name": name} if name else {})})
    described = {"format": 1, "name": stem, "parts": entries}
    (target / OBJECT_JSON).write_text(json.dumps(described, ensure_ascii=False))
    return target


def _write_glb(piece: Loaded, path: Path) -> Path:
    # Without normals, which would split its vertices.
    path.write_bytes(mesh_to_glb(to_mesh(piece), y_up=True, smooth=False))
    return path


class Unpacker:
    """Collects the content of :class:`Unpacked`; a bad object doesn't stop the others."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.files: dict[str, Path] = {}
        self.problems: dict[str, str] = {}

    def add(self, asset: str, stem: str, pieces: Pieces) -> None:
        """Write one object; ``pieces`` is called for its geometry."""
        self.put(asset, lambda: write_object(self._folder, stem, pieces()))

    def put(self, asset: str, write: Callable[[], Path]) -> None:
        """Take the file or folder that ``write`` writes."""
        try:
            self.files[asset] = write()
        except (
            ArtiworldError,
            KeyError,
            IndexError,
            TypeError,
            ValueError,
            AttributeError,
            OverflowError,
        ) as error:
            kind = "" if isinstance(error, ArtiworldError) else f"{type(error).__name__}: "
            self.problems[asset] = f"its geometry can't be used: {kind}{error}"

    def result(self) -> Unpacked:
        """All of it."""
        return Unpacked(self.files, self.problems)


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
    """True if the scene's own file holds all assets."""
    inside = f"{scene.path.name}#"
    return _geometry_reader(scene) is not None and all(
        o.asset is None or o.asset.startswith(inside) for o in scene.objects
    )


def _geometry_reader(scene: Scene) -> GeometryReader | None:
    reader = load_reader(scene.reader)
    return reader if isinstance(reader, GeometryReader) else None
