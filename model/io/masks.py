"""Masks that another system made, as the parts of an asset: one whole label for each element.

============================  ====================================================================
what                          how it is read
============================  ====================================================================
``.npy``                      (N,) labels, or (N, 1)
``.npz``                      labels (:data:`INSTANCE`, else :data:`SEMANTIC`), maybe ``names``,
                              and maybe ``points`` or ``vertices`` with ``faces``
``.ply``                      such a property of its vertices or triangles
``.glb``, ``.gltf``           a part for each mesh, named after its node
a folder of meshes or clouds  a part for each file
a folder of painted clouds    PartSLIP's ``instance_seg/<part name>.ply``: all points in each file,
                              black ones aside each colour is an instance
============================  ====================================================================

Labels of an ``.npy`` or ``.npz`` belong to the mesh or cloud beside it (:func:`_geometry_beside`),
else to the asset's own elements, in order. -1 is no part. Where masks have geometry of their own,
each point of the asset's surface takes the label of the nearest one, and each face the label of
most of its points, so resolutions may differ; a normalised or turned copy is brought back first.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.asset import MAX_PARTS, Asset, UpAxis
from model.core.errors import InputFileError
from model.core.part_names import base_score
from model.core.rotations import affine
from model.geometry.sampling import sample_surface
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, join, read_bytes
from model.io.formats.npz import read_npz
from model.io.formats.ply import read_ply_columns
from model.io.geometry_files import FOLDER_SUFFIXES, file_digest, load_geometry, turned_up
from model.io.part_folder import find_manifest
from model.io.source_checks import to_mesh

INSTANCE = (
    "instance", "instances", "instance_label", "instance_labels", "instance_seg", "instance_id",
    "ins_seg", "label", "labels", "part", "part_id", "part_ids", "part_label", "face_part_ids",
    "face_ids", "face_labels", "segment", "segments",
)  # fmt: skip
"""Names of arrays and properties with one label an element, the first that is there counts."""
SEMANTIC = ("semantic", "semantics", "semantic_label", "semantic_labels", "semantic_seg", "sem_seg",
            "category", "class", "scalar_label")  # fmt: skip
"""Names of those that tell what kind of part an element belongs to, indices into ``names``."""
NAMES = ("names", "part_names", "class_names", "classes", "categories")
REMEDY = (
    "give an .npy or .npz with one whole number a face or point, a .ply with such a property, a "
    ".glb with a mesh a part, or a folder of these"
)
LEAST_REST = 0.02
"""Share of the surface from which elements without a mask are the base, not gaps."""
REACH = 0.005
"""Distance, in diagonals, beyond which a mask isn't the element's: less than gaps at doors."""
APART = 0.03
"""Mean distance, in diagonals, beyond which masks are those of another object."""
SAMPLES = 30_000
"""Points on a surface that carry its labels to another one."""
_MARGIN = 0.004
"""Improvement, in diagonals, that a less simple placement must bring; as ``evaluate`` has it."""
_UNNAMED = re.compile(r"((link|part|mesh|geometry|node|object|group|segment)[_\-. ]*)*\d*", re.I)

Labels = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Masks:
    """What a file of masks holds.

    Attributes:
        path: the file or folder.
        sha256: of what was read.
        labels: (N,) of the faces of ``geometry``, of its points where it has other counts, or of
            the asset's elements where it is None; -1 is none.
        names: label → what the part is called, where the file tells it.
        geometry: in its own frame, or None.
    """

    path: Path
    sha256: str
    labels: Labels
    names: Mapping[int, str] = field(default_factory=dict)
    geometry: Loaded | None = None

    @property
    def origin(self) -> str:
        """The file and the start of its hash, as provenance has it."""
        return f"{self.path.name} (sha256 {self.sha256[:12]})"


def with_masks(asset: Asset, masks: Masks | str | Path) -> Asset:
    """The asset cut into parts by masks; joints that it declares no longer fit and are dropped.

    Part 0, the base, is what has no mask where that is :data:`LEAST_REST` of the surface or more,
    else the part whose name says so, else the largest. The others follow in the order of labels.

    Args:
        asset: as ``open_asset`` reads it.
        masks: or their file or folder.

    Raises:
        InputFileError: where they can't be read, don't belong to the asset, or cut nothing.
    """
    if not isinstance(masks, Masks):
        masks = read_masks(masks)
    labels = _on_elements(asset, masks)
    weight = np.ones(len(labels)) if asset.mesh is None else asset.mesh.face_areas
    kept = np.unique(labels[labels >= 0])
    if len(kept) > MAX_PARTS:
        raise InputFileError(
            masks.path, f"holds {len(kept)} masks of {asset.name}; {MAX_PARTS} parts are the limit",
            "give a coarser segmentation",
        )  # fmt: skip
    base = _base(labels, kept, weight, masks.names)
    moving = [int(label) for label in kept if label != base]
    if not moving:
        raise InputFileError(masks.path, f"has one label for all of {asset.name}: it cuts nothing")
    part = np.zeros(len(labels), np.int32)
    for number, label in enumerate(moving, 1):
        part[labels == label] = number
    names = tuple(masks.names.get(label, "") for label in (-1 if base is None else base, *moving))
    return replace(asset, element_part=part, part_names=names, tree=None)


def read_masks(path: str | Path) -> Masks:
    """Read masks; see the module's text.

    Raises:
        InputFileError: naming the file, the first wrong label, and what would be right.
    """
    path = Path(path)
    if path.is_dir():
        return _of_folder(path)
    reader = {".npy": _of_npy, ".npz": _of_npz, ".ply": _of_ply, ".glb": _of_gltf,
              ".gltf": _of_gltf}.get(path.suffix.lower())  # fmt: skip
    if reader is None:
        told = "no such file or folder" if not path.exists() else "holds no masks that are known"
        raise InputFileError(path, told, REMEDY)
    return reader(path)


# --- files


def _of_npy(path: Path) -> Masks:
    with _arrays(path):
        array = np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
    labels = _checked(path, array, "its array")
    return Masks(path, file_digest([path]), labels, {}, _geometry_beside(path, len(labels)))


def _of_npz(path: Path) -> Masks:
    with _arrays(path), np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as file:
        held = {key: file[key] for key in file.files}
    instance, semantic = (_first(held, keys) for keys in (INSTANCE, SEMANTIC))
    key = instance or semantic
    if key is None:
        there = ", ".join(held) or "nothing"
        raise InputFileError(path, f"holds {there}, none of {', '.join(INSTANCE)}", REMEDY)
    labels = _checked(path, held[key], key)
    kinds = labels if semantic is None else _checked(path, held[semantic], semantic)
    if len(kinds) != len(labels):
        raise InputFileError(
            path, f"{key} has {len(labels):,} elements, {semantic} {len(kinds):,}",
            "both need one label an element",
        )  # fmt: skip
    table = held.get(_first(held, NAMES) or "", np.zeros(0, "U1"))
    names = {}
    for label, kind in zip(*_majority(labels, kinds), strict=True):
        if 0 <= kind < len(table) and table.dtype.kind == "U" and (name := _name(str(table[kind]))):
            names[int(label)] = name
    geometry = _geometry_beside(path, len(labels))
    if any(k in held for k in ("points", "vertices", "xyz")):
        geometry = read_npz(path)
    return Masks(path, file_digest([path]), labels, names, geometry)


def _of_ply(path: Path) -> Masks:
    known = (*INSTANCE, *SEMANTIC)
    loaded, columns = read_ply_columns(path, known)
    if not columns:
        loaded, columns = read_ply_columns(path, known, element="face")
    key = _first(columns, known)
    if key is None:
        wanted = ", ".join(INSTANCE[:4])
        raise InputFileError(
            path, "no property of its vertices or triangles is a label",
            f"call an integer property {wanted} or the like",
        )  # fmt: skip
    labels = _checked(path, columns[key], f"property {key}")
    return Masks(path, file_digest([path]), labels, {}, loaded)


def _of_gltf(path: Path) -> Masks:
    loaded = load_geometry(path, DEFAULT_MAX_BYTES)
    names, sizes = zip(*loaded.pieces, strict=True) if loaded.pieces else ((), ())
    if len(names) < 2 or sum(sizes) != len(loaded.faces):
        raise InputFileError(path, "is not made of several meshes", "a mesh a part is needed")
    labels = np.repeat(np.arange(len(names)), sizes)
    named = {i: n for i, name in enumerate(names) if (n := _name(name))}
    return Masks(path, file_digest([path]), labels, named, loaded)


def _of_folder(folder: Path) -> Masks:
    inner = folder / "instance_seg"
    manifest = find_manifest(inner if inner.is_dir() else folder, FOLDER_SUFFIXES)
    paths = [e.path for e in manifest.entries]
    loaded = [load_geometry(p, DEFAULT_MAX_BYTES) for p in paths]
    digest = file_digest(paths)
    names = [_name(e.name or e.path.stem) for e in manifest.entries]
    if _painted(loaded):
        return Masks(folder, digest, *_instances(loaded, names), loaded[0])
    solid = [p for p in loaded if len(p.faces)]
    if len(solid) not in (0, len(loaded)):
        cloud = next(p for p, held in zip(paths, loaded, strict=True) if not len(held.faces))
        raise InputFileError(cloud, "is a cloud among meshes", "give all parts as one or the other")
    sizes = [len(p.faces) if solid else len(p.vertices) for p in loaded]
    labels = np.repeat(np.arange(len(loaded)), sizes)
    return Masks(folder, digest, labels, {i: n for i, n in enumerate(names) if n}, join(loaded))


def _painted(loaded: list[Loaded]) -> bool:
    """Whether these are one cloud in several colours, black where it is none of the part."""
    first = loaded[0]
    return all(
        not len(p.faces) and p.colors is not None and p.vertices.shape == first.vertices.shape
        and np.allclose(p.vertices, first.vertices, equal_nan=True)
        and not p.colors[:, :3].any(axis=1).all()
        for p in loaded
    )  # fmt: skip


def _instances(loaded: list[Loaded], names: list[str]) -> tuple[Labels, dict[int, str]]:
    labels = np.full(len(loaded[0].vertices), -1, np.int64)
    called: dict[int, str] = {}
    for piece, name in zip(loaded, names, strict=True):
        assert piece.colors is not None
        colors = piece.colors[:, :3].astype(np.int64) @ [1 << 16, 1 << 8, 1]
        for color in np.unique(colors[colors > 0]):
            called[len(called)] = name
            labels[colors == color] = len(called) - 1
    return labels, {label: name for label, name in called.items() if name}


def _geometry_beside(path: Path, count: int) -> Loaded | None:
    """The mesh or cloud that labels were written for, as public code lays it out: of the same name
    (P3-SAM without ``_face_ids``), in ``ply/`` (PartField) or in ``vis_pcd/`` (SAMPart3D)."""
    stem = path.stem.removesuffix("_face_ids")
    above = path.parent.parent
    for folder in (path.parent, above / "ply", above.parent / "vis_pcd" / path.parent.name):
        for suffix in (".ply", ".glb", ".obj"):
            file = folder / f"{stem}{suffix}"
            if file.is_file():
                loaded = load_geometry(file, DEFAULT_MAX_BYTES)
                if count in (len(loaded.faces), len(loaded.vertices)):
                    return loaded
    return None


# --- values


@contextmanager
def _arrays(path: Path) -> Iterator[None]:
    """Turn what numpy says of damaged files into an error that names the file."""
    try:
        yield
    except (OSError, ValueError, KeyError, EOFError, SyntaxError, zipfile.BadZipFile) as error:
        more = "pickled objects aren't read" if "pickle" in str(error) else str(error)[:120]
        raise InputFileError(path, f"is no array of labels ({more})", REMEDY) from None


def _first(held: Mapping[str, Any], keys: tuple[str, ...]) -> str | None:
    lower = {key.lower(): key for key in held}
    return next((lower[key] for key in keys if key in lower), None)


def _name(text: str) -> str:
    """What a part is called; "" for names such as ``mesh_3``. ``door@0`` is an instance of door."""
    plain = "".join(c for c in re.sub(r"@\d+$", "", text) if c.isprintable()).strip()
    return "" if _UNNAMED.fullmatch(plain) else plain


def _checked(path: Path, value: Any, what: str) -> Labels:
    """(N,) labels; P3-SAM's -2, a face that no sample hit, is -1."""
    array = np.asarray(value)
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim != 1 or array.dtype.kind not in "iufb":
        raise InputFileError(
            path, f"{what} has shape {array.shape} of {array.dtype}",
            "one whole number a face or point is needed",
        )  # fmt: skip
    if not len(array):
        raise InputFileError(path, f"{what} is empty", REMEDY)
    numbers = array.astype(np.float64)
    wrong = ~np.isfinite(numbers) | (numbers != np.round(numbers)) | (np.abs(numbers) > 2**52)
    least = -2 if path.stem.endswith("_face_ids") else -1
    wrong |= numbers < least
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputFileError(
            path, f"{what} is {array[at]} at element {at:,}",
            "labels are whole numbers from 0, and -1 for none",
        )  # fmt: skip
    return np.maximum(numbers, -1).astype(np.int64)


def _base(labels: Labels, kept: Labels, weight: FloatArray, names: Mapping[int, str]) -> int | None:
    """The label of the base; None where what has no label is."""
    whole = max(float(weight.sum()), 1e-300)
    if float(weight[labels < 0].sum()) / whole >= LEAST_REST:
        return None
    scores = {int(label): base_score(names.get(int(label)), None) for label in kept}
    best = max(scores, key=lambda label: scores[label])
    if scores[best] > 0:
        return best
    return max(scores, key=lambda label: float(weight[labels == label].sum()))


# --- from one surface to another


def _on_elements(asset: Asset, masks: Masks) -> Labels:
    """(E,) labels of the asset's elements, -1 for none."""
    own = None
    if len(masks.labels) == asset.element_count:
        own = masks.labels
    elif asset.mesh is not None and len(masks.labels) == len(asset.mesh.vertices):
        own = _of_faces(masks.labels, asset.mesh.faces)
    if masks.geometry is None:
        if own is None:
            kind = asset.element_kind
            raise InputFileError(
                masks.path, f"has {len(masks.labels):,} labels for the {asset.element_count:,} "
                f"{kind}s of {asset.name}",
                f"give one a {kind}, or put the mesh or cloud that they belong to beside it as "
                f"{masks.path.stem}.ply",
            )  # fmt: skip
        return own
    points, labels = _labelled_points(masks)
    every = np.arange(asset.element_count)
    surface, element = (
        (asset.element_centers, every) if asset.mesh is None else _spread(asset.mesh, every)
    )
    placed, distance = _placed(points, surface, asset)
    diagonal = asset.diagonal or 1.0
    if distance > APART * diagonal:
        if own is not None:
            return own
        raise InputFileError(
            masks.path, f"its geometry isn't that of {asset.name}: on average "
            f"{100 * distance / diagonal:.0f} % of the object's size away",
            "give masks of the same object",
        )  # fmt: skip
    tree = KDTree(placed)
    spacing = float(np.median(tree.query(placed[:: max(1, len(placed) // 2000)], k=2)[0][:, 1]))
    far, nearest = tree.query(surface)
    found = np.where(far > max(REACH * diagonal, 3 * spacing), -1, labels[nearest])
    return _majority(element, found)[1]  # every element has a point


def _labelled_points(masks: Masks) -> tuple[FloatArray, Labels]:
    """(P, 3) points of the masks' own geometry, and (P,) their labels."""
    held, labels = masks.geometry, masks.labels
    assert held is not None
    if len(labels) != len(held.faces):
        if len(labels) != len(held.vertices):
            raise InputFileError(
                masks.path, f"has {len(labels):,} labels for {len(held.faces):,} faces and "
                f"{len(held.vertices):,} vertices", "one label for each is needed",
            )  # fmt: skip
        if not len(held.faces):
            points = held.vertices.astype(np.float64)
            kept = np.isfinite(points).all(axis=1)
            return points[kept], labels[kept]
        labels = _of_faces(labels, held.faces)
    plain = Loaded(np.nan_to_num(held.vertices.astype(np.float64)), held.faces)
    return _spread(to_mesh(plain), labels)


def _of_faces(labels: Labels, faces: npt.NDArray[Any]) -> Labels:
    """(F,) what two of a face's corners say, of (V,) labels."""
    a, b, c = labels[faces].T
    return np.where((b == c) & (a != b), b, a)


def _spread(mesh: Any, values: Labels) -> tuple[FloatArray, Labels]:
    """The middle of each face and :data:`SAMPLES` points over all, with the faces' values."""
    points, face = [mesh.triangles.mean(axis=1)], [np.arange(len(mesh.faces))]
    if mesh.face_areas.sum() > 0:
        cloud, of = sample_surface(mesh, SAMPLES, np.random.default_rng(0))
        points.append(cloud.points.astype(np.float64))
        face.append(of.astype(np.int64))
    return np.concatenate(points), values[np.concatenate(face)]


def _majority(groups: Labels, values: Labels) -> tuple[Labels, Labels]:
    """Each group and the value that most of its members have, none (-1) only where all have it."""
    known = values >= 0
    rows = np.concatenate([
        np.stack([groups[known], values[known]], 1),
        np.stack([groups, np.full(len(groups), -1)], 1)[~known],
    ])  # fmt: skip
    pairs, counts = np.unique(rows, axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1] < 0, -counts, pairs[:, 0]))
    kept, first = np.unique(pairs[order, 0], return_index=True)
    return kept, pairs[order[first], 1]


def _placed(points: FloatArray, surface: FloatArray, asset: Asset) -> tuple[FloatArray, float]:
    """The masks' points in the asset's frame, and their mean distance from its surface."""
    rng = np.random.default_rng(0)
    some = points[rng.permutation(len(points))[:3000]]
    tree = KDTree(surface)
    cap = 0.1 * (asset.diagonal or 1.0)
    costs: list[tuple[float, FloatArray]] = []
    for matrix in _placements(points, asset):
        moved = some @ matrix[:3, :3].T + matrix[:3, 3]
        costs.append((float(np.minimum(tree.query(moved)[0], cap).mean()), matrix))
    best = min(cost for cost, _ in costs) + _MARGIN * (asset.diagonal or 1.0)
    cost, matrix = next(each for each in costs if each[0] <= best)
    return points @ matrix[:3, :3].T + matrix[:3, 3], cost


def _placements(points: FloatArray, asset: Asset) -> Iterator[FloatArray]:
    """(4, 4) from the masks' file to the asset: as the asset was read, other axes up, and each of
    them fitted to the box, as networks normalise what they see."""
    source = asset.source
    unit, own = (1.0, "z") if source is None else (source.unit_scale, source.up_axis)
    shift = np.zeros(3) if source is None else -np.asarray(source.shift)
    axes = sorted(get_args(UpAxis), key=lambda axis: axis != own)
    for axis in axes:
        yield affine(unit * turned_up(axis)[:3, :3], shift)
    low, high = asset.bounds
    for axis in axes:
        turn = turned_up(axis)[:3, :3]
        turned = points @ turn.T
        size = float(np.linalg.norm(np.ptp(turned, axis=0))) or 1.0
        scale = asset.diagonal / size
        middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
        yield affine(scale * turn, (low + high) / 2 - scale * middle)
