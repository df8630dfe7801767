"""Assets of a scene: indexed by id, and the rigid parts that each declares or was cut into.

Scenes name assets by ids; folders of 3D assets are searched for them. An asset declares its parts,
or an annotator must segment it, by clicks made in the scene or kept beside it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from model.core.articulated_object import Inertial, Part, SegmentedObject, remarks_of
from model.core.asset import Asset
from model.core.errors import ArtiworldError, InputFileError, PromptError
from model.core.files import file_sha256
from model.core.geometry import affine, merged, merged_clouds
from model.core.names import MOST_NAMED
from model.core.shapes import Shape, moved_shape
from model.core.tree import KinematicTree
from model.geometry.cleaning import outlier_points
from model.geometry.splitting import split
from model.geometry.topology import connected_shells
from model.io.assets.reader import declared_links
from model.io.geometry_files import FOLDER_SUFFIXES
from model.io.merging import read_rigid
from model.io.model_files import is_part_folder
from model.io.open_asset import open_asset, read_part_files
from model.io.urdf.files import MOBILITY, MODEL_CONFIG, URDF_SUFFIX, gazebo_model
from model.io.urdf.sdf import is_sdf
from model.scenes.scene import Anchor, FloatArray, SceneObject
from model.segmentation.prompts import Click, Prompts, Region
from model.segmentation.registry import load_segmenter

_URDF_NAMES = (MOBILITY, "object.urdf", MODEL_CONFIG)
_FOLDERS_MODEL = "raw_model"
"""Name of the mesh in the folder of each model of 3D-FUTURE."""


@dataclass(frozen=True)
class AssetIndex:
    """Index of assets by id.

    Attributes:
        folders: that were searched.
        by_id: id in lower case → file or folder. An asset's ids are its name, its name without
            suffix and its path below the searched folder, with and without suffix; a 3D-FUTURE
            model's is its folder.
        ambiguous: ids that several assets have; the first in the order of ``folders`` counts.
    """

    folders: tuple[Path, ...]
    by_id: dict[str, Path] = field(default_factory=dict)
    ambiguous: frozenset[str] = frozenset()

    def find(self, id: str) -> Path | None:
        """The asset called ``id``, which may be a path: its last folders count most.

        ``../models/Microwave/7128/mobility.urdf`` is found as ``models/microwave/7128``, else as
        ``microwave/7128``, else as ``7128``.
        """
        words = [w for w in id.replace("\\", "/").lower().split("/") if w not in ("", ".", "..")]
        if not words:
            return None
        ends = [words]
        if len(words) > 1 and "." in words[-1]:
            ends.append(words[:-1])  # the folder that the file is in
        for end in ends:
            for start in range(len(end)):
                found = self.by_id.get("/".join(end[start:]))
                if found is not None:
                    return found
        return None


def index_assets(folders: Iterable[str | Path]) -> AssetIndex:
    """Search folders in depth for assets.

    An asset is a folder with a ``mobility.urdf`` or ``object.urdf``, that of a Gazebo model, a
    folder of part meshes, another URDF or SDF, or a mesh file.

    Raises:
        InputFileError: where a folder isn't there.
    """
    roots = tuple(Path(f) for f in folders)
    by_id: dict[str, Path] = {}
    ambiguous: set[str] = set()
    for root in roots:
        if not root.is_dir():
            raise InputFileError(root, "no such folder", "give a folder of assets")
        for path in _assets_in(root):
            for id in _ids(root, path):
                if by_id.setdefault(id, path) != path:
                    ambiguous.add(id)
    return AssetIndex(roots, by_id, frozenset(ambiguous))


def _is_asset_folder(folder: Path, files: list[str]) -> bool:
    if any(name in files for name in _URDF_NAMES):
        return True
    return is_part_folder(folder, FOLDER_SUFFIXES)


def _assets_in(root: Path) -> Iterable[Path]:
    for where, below, files in os.walk(root):
        below.sort()
        folder = Path(where)
        if _is_asset_folder(folder, files):
            below.clear()
            yield folder
            continue
        for name in sorted(files):
            suffix = Path(name).suffix.lower()
            if suffix in (*FOLDER_SUFFIXES, URDF_SUFFIX) or is_sdf(folder / name):
                yield folder / name


def _ids(root: Path, path: Path) -> set[str]:
    inside = path.relative_to(root) if path != root else Path(path.name)
    out = {path.name, inside.as_posix()}
    if path.is_file():
        out |= {path.stem, inside.with_suffix("").as_posix()}
    if path.stem == _FOLDERS_MODEL and path.parent != root:
        out |= {path.parent.name, inside.parent.as_posix()}
        out -= {path.name, path.stem}  # what all are called, so that none stands for another
    return {id.lower() for id in out}


def asset_digest(path: Path) -> str:
    """SHA-256 over an asset's files, the same for copies wherever they lie.

    Raises:
        InputFileError: where a file can't be read.
    """
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    whole = hashlib.sha256()
    try:
        for file in files:
            name = file.name if file == path else file.relative_to(path).as_posix()
            whole.update(f"{name}\0{file_sha256(file)}\n".encode())
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}") from error
    return whole.hexdigest()


MOST_PIECES = MOST_NAMED
"""Connected pieces up to which they pass for parts; beyond, they are screws and panels."""
SAME = 1e-3
"""Scales that differ less from 1 are rounding."""


class LeftForAnnotator(ArtiworldError):
    """The asset declares no parts; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class AssetParts:
    """Parts in the asset's own frame, metres, +z up.

    Attributes:
        how: human-readable origin of the cut.
        truth: the joints of the asset's own URDF, where it has one.
        notes: human-readable remarks on changes made on reading that URDF.
        inertials: link → mass properties where that URDF declares them.
        shapes: link → collision shapes where it declares them.
    """

    parts: tuple[Part, ...]
    how: str
    truth: KinematicTree | None = None
    notes: tuple[str, ...] = ()
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)


def known_parts(path: Path) -> AssetParts:
    """Parts by the asset's links, part files, named meshes, or connected pieces, in this order.

    Raises:
        LeftForAnnotator: where none of these tells at least two parts.
        InputFileError: where the asset can't be read.
    """
    if path.is_dir():
        if (path / MOBILITY).is_file():
            return _of_urdf(path / MOBILITY)
        if (path / "object.urdf").is_file():
            return _of_urdf(path / "object.urdf")
        if is_part_folder(path, FOLDER_SUFFIXES):
            return _at_least_two(read_part_files(path).parts, "its part files")
    file = gazebo_model(path) if path.is_dir() else path
    if file is not None and is_sdf(file):
        return _of_urdf(file)
    asset = read_unshifted(path)
    if asset.element_part is not None and not path.is_dir():
        named = split(asset, asset.element_part, dict(enumerate(asset.part_names)))
        return AssetParts(named, "its named meshes")
    return _pieces(asset)


def read_unshifted(path: Path) -> Asset:
    """The asset in its file's own frame, where scenes count from, even far from its origin."""
    return _unshifted(open_asset(path))


def whole(path: Path) -> Part:
    """The asset as one rigid part ``link_0``.

    Raises:
        InputFileError: where it can't be read.
    """
    if path.is_dir() and not (path / MOBILITY).is_file() and (path / "object.urdf").is_file():
        parts = read_rigid(path / "object.urdf", root=path.parent)[0].parts
        meshes = [p.mesh for p in parts if p.mesh is not None]
        clouds = [p.cloud for p in parts if p.cloud is not None]
        return Part(
            "link_0",
            merged(meshes) if meshes else None,
            merged_clouds(clouds) if clouds and not meshes else None,
            remarks=remarks_of(parts),
        )
    asset = read_unshifted(path)
    cloud = None if asset.mesh is not None else asset.cloud
    return Part("link_0", asset.mesh, cloud, remarks=asset.warnings)


def scaled(parts: tuple[Part, ...], factors: FloatArray) -> tuple[Part, ...]:
    """Parts stretched, and mirrored by negative factors (3,), about the asset's origin."""
    return tuple(p.moved(affine(np.diag(factors))) for p in parts)


def masses_at(known: AssetParts, factors: FloatArray) -> Mapping[str, Inertial]:
    """Mass properties by link that the asset tells; none where the factors (3,) aren't 1, as at
    another size it weighs something else."""
    return known.inertials if bool((abs(factors - 1) < SAME).all()) else {}


def scaled_shapes(
    shapes: Mapping[str, tuple[Shape, ...]], factors: FloatArray
) -> dict[str, tuple[Shape, ...]]:
    """Collision shapes at another size; none where the factors (3,) differ or mirror, as a
    stretched cylinder is none."""
    if not np.allclose(factors, factors[0], rtol=1e-6) or not factors[0] > 0:
        return {}
    matrix = np.diag([*factors, 1.0])
    return {link: tuple(moved_shape(s, matrix) for s in held) for link, held in shapes.items()}


def bounds_of(parts: tuple[Part, ...]) -> FloatArray:
    """(2, 3) lowest and highest corner; of scans without stray points, which would have the object
    stand in the air."""
    clouds = [p.cloud.points for p in parts if p.mesh is None and p.cloud is not None]
    meshes = tuple(p for p in parts if p.mesh is not None)
    each = [SegmentedObject("bounds", meshes).bounds] if meshes else []
    if clouds:
        # All at once: an outlier of one part may lie on the surface of another.
        points = np.concatenate(clouds)
        kept = np.ones(len(points), bool)
        kept[outlier_points(points, KDTree(points))] = False
        each.append(np.stack([points[kept].min(axis=0), points[kept].max(axis=0)]))
    low, high = np.stack(each).astype(np.float64).swapaxes(0, 1)
    return np.stack([low.min(axis=0), high.max(axis=0)])


def size_factors(obj: SceneObject, parts: tuple[Part, ...]) -> FloatArray:
    """(3,) factors that bring an asset's parts to the object's size in the scene."""
    return obj.scale if obj.fit is None else obj.placed(bounds_of(parts)).scale


def _at_least_two(parts: tuple[Part, ...], how: str) -> AssetParts:
    if len(parts) < 2:
        raise LeftForAnnotator(f"{how} are a single part; cut it by clicks")
    return AssetParts(parts, how)


def _of_urdf(path: Path) -> AssetParts:
    root = None if path.name == MOBILITY or is_sdf(path) else path.parent.parent
    obj, model, _ = read_rigid(path, root=root, shapes=True)
    # Not the remarks on merged links: that fixed links are one part is no change.
    found = _at_least_two(obj.parts, f"links of its {path.suffix[1:].upper()}")
    weighed, shaped = (declared_links(path.parent, what) for what in ("masses", "collision"))

    def its_own(link: str, listed: list[str] | None) -> bool:
        return listed is None or bool({link, link.removeprefix("link_")} & set(listed))

    return replace(
        found,
        truth=obj.tree,
        notes=(*model.notes, *model.declared.notes),
        inertials={link: i for link, i in obj.inertials.items() if its_own(link, weighed)},
        shapes={link: held for link, held in obj.shapes.items() if its_own(link, shaped)},
    )


def _pieces(asset: Asset) -> AssetParts:
    if asset.mesh is None:
        raise LeftForAnnotator("it is a point cloud without parts; cut it by clicks")
    shells = connected_shells(asset.mesh)
    count = int(shells.max()) + 1 if len(shells) else 0
    if not 2 <= count <= MOST_PIECES:
        pieces = "one connected piece" if count == 1 else f"{count} connected pieces"
        raise LeftForAnnotator(
            f"its mesh is {pieces}; two to {MOST_PIECES} pass for parts, so cut it by clicks"
        )
    return AssetParts(split(asset, shells), "its connected pieces")


def _unshifted(asset: Asset) -> Asset:
    """In the file's own frame, where scenes count from, even far from its origin."""
    shift = np.asarray(asset.source.shift if asset.source is not None else (0.0, 0.0, 0.0))
    if not shift.any():
        return asset
    back = affine(shift=shift)
    mesh, cloud = (None if g is None else g.moved(back) for g in (asset.mesh, asset.cloud))
    return replace(asset, mesh=mesh, cloud=cloud)


FAR = 0.1
"""A click further from the object than this share of its diagonal belongs to something else."""


@dataclass(frozen=True, eq=False)
class ObjectClicks:
    """Clicks of a person on one object.

    Attributes:
        prompts: positions in metres, +z up; elements, where a click or a region names them, are the
            object's own.
        names: part → display name.
        category: of the object, or None.
        segmenter: registered name.
        in_scene: whether positions are the scene's; else the asset's own, before its scale.
    """

    prompts: Prompts
    names: Mapping[int, str] = field(default_factory=dict)
    category: str | None = None
    segmenter: str = "default"
    in_scene: bool = True

    def key(self) -> list[object]:
        """Equal clicks have equal keys."""
        return [self.prompts.key(), sorted(self.names.items()), self.category, self.segmenter]


@dataclass(frozen=True, eq=False)
class ClickedObject:
    """Clicks, and where the object stands that was clicked on."""

    clicks: ObjectClicks
    world_from_object: FloatArray
    anchor: Anchor


def clicked_parts(path: Path, holder: SceneObject, clicks: ObjectClicks) -> AssetParts:
    """Parts in the asset's own frame.

    Args:
        path: of the asset.
        holder: where it stands, and at which size.

    Raises:
        PromptError: where a click is on something else, or no part but the base got anything.
        InputFileError: where the asset can't be read.
    """
    asset = read_unshifted(path)
    placed = holder.placed(bounds_of((Part("link_0", asset.mesh, asset.cloud),)))
    turn, at = placed.world_from_asset[:3, :3], placed.world_from_asset[:3, 3]
    items: list[Click | Region] = list(clicks.prompts.items)
    where = np.array([c.position for c in clicks.prompts.clicks]).reshape(-1, 3)
    local = (where - at) @ turn / placed.scale if clicks.in_scene else where
    away = KDTree(asset.element_centers).query(local)[0] if len(local) else np.zeros(0)
    if len(away) and away.max() > FAR * asset.diagonal:
        worst = int(away.argmax())
        raise PromptError(
            f"clicks[{worst}] at {where[worst].tolist()} is {away[worst]:.3g} m away from it; "
            f"give positions in {'the scene' if clicks.in_scene else 'its frame'}, metres, +z up"
        )
    moved = iter(local.tolist())
    for i, item in enumerate(items):
        if isinstance(item, Click):
            x, y, z = next(moved)
            items[i] = Click((x, y, z), item.part, item.positive, item.element)
    session = load_segmenter(clicks.segmenter).encode(asset)
    answer = session.segment(Prompts(tuple(items)))
    parts = split(asset, answer.labels, clicks.names)
    if len(parts) < 2:
        raise PromptError("the clicks leave it in one part; click on its moving parts")
    return AssetParts(parts, "clicks")
