"""Assets on disk as memory-mapped arrays, so that processes share them and reopening is instant.

A folder holds ``asset.json`` (format version 6), one ``.npy`` file an array, the textures, and
``shapes.npz`` where the source tells collision shapes. Version 1 lacks metallic and roughness,
version 2 the joints that a source tells, version 3 its masses, version 4 maps of normals, emission
and occlusion, version 5 collision shapes: such copies are made again from their source.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from PIL import Image

from model.core import codec
from model.core.articulated_object import Inertial
from model.core.asset import Asset, Source
from model.core.errors import GeometryError, InputFileError, KinematicsError
from model.core.files import draft_of, written_to
from model.core.geometry import Material, Mesh, PointCloud
from model.core.shapes import Shape
from model.core.textures import ImageFile, SurfaceMaps, TextureError, encode, open_texture
from model.core.tree import KinematicTree
from model.physics.collision.store import packed, unpacked

FORMAT_VERSION = 6
_META = "asset.json"
_SHAPES = "shapes.npz"
_MESH = ("vertices", "faces", "face_material", "uv", "vertex_colors")
_MAPS = ("normal", "emissive", "occlusion")
_CLOUD = ("points", "normals", "colors", "confidence")


def save_asset(
    asset: Asset, folder: str | Path, whole: Callable[[Path], bool] = lambda _: False
) -> None:
    """Write ``asset`` into ``folder``, which appears complete or not at all.

    What is in ``folder`` already is replaced, unless it is ``whole``.

    Raises:
        InputFileError: where the folder can't be written.
    """
    folder = Path(folder)
    with written_to(folder, "check space and permissions"), draft_of(folder, whole) as draft:
        draft.mkdir()
        _write(asset, draft)


def _write(asset: Asset, folder: Path) -> None:
    meta: dict[str, Any] = {
        "format": "artiworld-asset",
        "version": FORMAT_VERSION,
        "name": asset.name,
        "category": asset.category,
        "part_names": list(asset.part_names),
        "warnings": list(asset.warnings),
        "tree": codec.write(asset.tree, "tree"),
        "inertials": {
            link: {"mass": i.mass, "center": i.center.tolist(), "tensor": i.tensor.tolist()}
            for link, i in asset.inertials.items()
        },
        "source": None,
        "mesh": None,
        "cloud": asset.cloud is not None,
    }
    if asset.source is not None:
        meta["source"] = asdict(asset.source) | {"path": str(asset.source.path)}
    if asset.shapes:
        np.savez(folder / _SHAPES, **packed(asset.shapes))  # type: ignore[arg-type]
    if asset.element_part is not None:
        _save(folder / "element_part.npy", asset.element_part)
    if asset.mesh is not None:
        meta["mesh"] = {"materials": _write_materials(asset.mesh.materials, folder)}
        for name in _MESH:
            _save(folder / f"mesh_{name}.npy", getattr(asset.mesh, name))
    if asset.cloud is not None:
        for name in _CLOUD:
            _save(folder / f"cloud_{name}.npy", getattr(asset.cloud, name))
    (folder / _META).write_text(json.dumps(meta, indent=1), "utf-8")


def _save(path: Path, array: npt.NDArray[Any] | None) -> None:
    if array is not None:
        np.save(path, array, allow_pickle=False)


def _write_materials(materials: tuple[Material, ...], folder: Path) -> list[dict[str, Any]]:
    files: dict[ImageFile, str] = {}

    def file_of(image: ImageFile | None) -> str | None:
        if image is None:
            return None
        if image not in files:
            files[image] = f"texture_{len(files)}{image.suffix}"
            (folder / files[image]).write_bytes(image.data)
        return files[image]

    out = []
    for m in materials:
        texture = None if m.texture is None else ImageFile(*encode(m.texture))
        maps = {f.name: getattr(m.maps, f.name) for f in fields(m.maps)}
        out.append(
            {
                "name": m.name,
                "base_color": list(m.base_color),
                "texture": file_of(texture),
                "metallic": m.metallic,
                "roughness": m.roughness,
                "maps": maps | {name: file_of(maps[name]) for name in _MAPS},
            }
        )
    return out


def load_asset(folder: str | Path, *, textures: bool = True) -> Asset:
    """Open what :func:`save_asset` wrote; arrays are memory-mapped read-only.

    Args:
        textures: False leaves out all images, as it takes seconds to decode large ones.

    Raises:
        InputFileError: where it is missing, damaged, or of a newer format.
    """
    folder = Path(folder)
    path = folder / _META
    try:
        meta = json.loads(path.read_text("utf-8"))
        version = meta["version"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = f"is no saved asset ({error})"
        raise InputFileError(path, why, "open the source file again") from None
    if version != FORMAT_VERSION:
        raise InputFileError(
            path,
            f"has format version {version}, this program reads {FORMAT_VERSION}",
            "update ArtiWorld or open the source file again",
        )
    try:
        return _read(folder, meta, textures)
    except (
        KeyError,
        TypeError,
        ValueError,
        OSError,
        EOFError,
        AssertionError,
        BadZipFile,
        GeometryError,
        KinematicsError,
        TextureError,
    ) as error:
        why = f"the saved asset is damaged ({error})"
        raise InputFileError(folder, why, "open the source file again") from None


def _read(folder: Path, meta: dict[str, Any], textures: bool) -> Asset:
    mesh = cloud = source = None
    if meta["mesh"] is not None:
        arrays = {name: _load(folder / f"mesh_{name}.npy") for name in _MESH}
        rows = meta["mesh"]["materials"]
        if not textures:
            bare = {"texture": None}
            rows = [row | bare | {"maps": row["maps"] | dict.fromkeys(_MAPS)} for row in rows]
        materials = _read_materials(rows, folder)
        mesh = Mesh(materials=materials, **arrays)  # type: ignore[arg-type]
    if meta["cloud"]:
        cloud = PointCloud(**{name: _load(folder / f"cloud_{name}.npy") for name in _CLOUD})  # type: ignore[arg-type]
    if meta["source"] is not None:
        row = meta["source"]
        shift = tuple(row["shift"])
        source = Source(Path(row["path"]), row["sha256"], row["up_axis"], row["unit_scale"], shift)
    return Asset(
        meta["name"],
        mesh,
        cloud,
        source,
        _load(folder / "element_part.npy"),
        tuple(meta["part_names"]),
        meta["category"],
        tuple(meta["warnings"]),
        None if meta["tree"] is None else codec.read(KinematicTree, meta["tree"], "tree"),
        {
            link: Inertial(row["mass"], np.array(row["center"]), np.array(row["tensor"]))
            for link, row in meta["inertials"].items()
        },
        _read_shapes(folder / _SHAPES),
    )


def _read_shapes(path: Path) -> dict[str, tuple[Shape, ...]]:
    if not path.exists():
        return {}
    with np.load(path, allow_pickle=False) as data:
        return unpacked({name: data[name] for name in data.files})


def _load(path: Path) -> npt.NDArray[Any] | None:
    if not path.exists():
        return None
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    return np.asarray(array)


def _read_materials(rows: list[dict[str, Any]], folder: Path) -> tuple[Material, ...]:
    textures: dict[str, Image.Image] = {}
    files: dict[str, ImageFile] = {}
    out = []
    for row in rows:
        name = row["texture"]
        if name is not None and name not in textures:
            textures[name] = open_texture(folder / Path(name).name)
        red, green, blue, alpha = row["base_color"]
        texture = None if name is None else textures[name]
        color = (red, green, blue, alpha)
        maps = {name: _image_file(folder, row["maps"][name], files) for name in _MAPS}
        fields_of_maps = row["maps"] | maps | {"emission": tuple(row["maps"]["emission"])}
        out.append(
            Material(
                row["name"],
                color,
                texture,
                row["metallic"],
                row["roughness"],
                SurfaceMaps(**fields_of_maps),
            )
        )
    return tuple(out)


def _image_file(folder: Path, name: str | None, known: dict[str, ImageFile]) -> ImageFile | None:
    """A map as it was written; its pixels were looked at when it was read from the source."""
    if name is not None and name not in known:
        path = folder / Path(name).name
        known[name] = ImageFile(path.read_bytes(), path.suffix)
    return None if name is None else known[name]
