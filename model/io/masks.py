"""Masks that another system made, as the parts of an asset: one whole label for each element.

``docs/other-systems.md`` tells the files. -1 is no part. Labels of an array belong to the mesh or
cloud beside it (:func:`_beside`), else to the asset's own elements, in order. Where masks have
geometry of their own, each point of the asset's surface takes the label of the nearest one, and
each face the label of most of its points, so resolutions may differ; a normalised or turned copy is
brought back first.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.asset import MAX_PARTS, Asset, UpAxis
from model.core.errors import InputFileError
from model.core.geometry import affine
from model.core.names import base_score
from model.geometry.sampling import sample_surface
from model.io.formats.loaded import DEFAULT_MAX_BYTES, Loaded, join, read_bytes
from model.io.formats.ply import read_ply_columns
from model.io.formats.points import read_npz
from model.io.geometry_files import FOLDER_SUFFIXES, file_digest, load_geometry, to_mesh, turned_up
from model.io.model_files import find_manifest

INSTANCE = (
    *"instance instances instance_label instance_labels instance_seg instance_id ins_seg".split(),
    *"label labels part part_id part_ids part_label face_part_ids face_ids face_labels".split(),
    *"segment segments".split(),
)
"""Names of arrays and properties with one label an element, the first that is there counts."""
SEMANTIC = (
    *"semantic semantics semantic_label semantic_labels semantic_seg sem_seg category".split(),
    *"class scalar_label".split(),
)
"""Names of those that tell the kind of an element's part, indices into :data:`NAMES`."""
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
    """Content of a file of masks.

    Attributes:
        path: the file or folder. sha256: of what was read.
        labels: (N,) of the faces or points of ``geometry``, or of the asset's elements where it is
            None; -1 is none.
        names: label → part name, where the file declares it.
        geometry: in its own frame, or None.
    """

    path: Path
    sha256: str
    labels: Labels
    names: Mapping[int, str] = field(default_factory=dict)
    geometry: Loaded | None = None

    @property
    def origin(self) -> str:
        """The end of the file's name and the start of its hash, as provenance has it."""
        return f"{self.path.name[-45:]} (sha256 {self.sha256[:12]})"


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
    kept = np.unique(labels[labels >= 0]).tolist()
    base = -1
    if float(weight[labels < 0].sum()) < LEAST_REST * float(weight.sum()):
        area = {label: float(weight[labels == label].sum()) for label in kept}
        says = {label: max(base_score(masks.names.get(label), None), 0.0) for label in kept}
        base = max(kept, key=lambda label: (says[label], area[label]))
    moving = [label for label in kept if label != base]
    if not 0 < len(moving) < MAX_PARTS:
        problem = f"cuts {asset.name} into {len(kept)} part{'s'[: len(kept) != 1]}"
        raise InputFileError(masks.path, problem, f"two to {MAX_PARTS} are needed")
    part = np.zeros(len(labels), np.int32)
    for number, label in enumerate(moving, 1):
        part[labels == label] = number
    names = tuple(masks.names.get(label, "") for label in (base, *moving))
    return replace(asset, element_part=part, part_names=names, tree=None)


def read_masks(path: str | Path) -> Masks:
    """Read masks; see the module's text.

    Raises:
        InputFileError: naming the file, the first wrong label, and what would be right.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir():
        return _of_folder(path)
    if suffix in (".npy", ".npz"):
        return _of_arrays(path)
    if suffix == ".ply":
        return _of_ply(path)
    if suffix in (".glb", ".gltf"):
        loaded = load_geometry(path, DEFAULT_MAX_BYTES)
        if len(loaded.pieces) < 2 or sum(n for _, n in loaded.pieces) != len(loaded.faces):
            raise InputFileError(path, "is not made of several meshes", "a mesh a part is needed")
        names, sizes = zip(*loaded.pieces, strict=True)
        return _pieces(path, [path], names, sizes, loaded)
    problem = "holds no masks that are known" if path.exists() else "no such file or folder"
    raise InputFileError(path, problem, REMEDY)


# --- files


def _of_arrays(path: Path) -> Masks:
    """A single array of labels, or an archive with names and maybe geometry."""
    with _damage_named(path):
        loaded = np.load(io.BytesIO(read_bytes(path)), allow_pickle=False)
        held = {"its array": loaded}
        if path.suffix.lower() == ".npz":
            held = {key: loaded[key] for key in loaded.files}
    key = _first(held, ("its array", *INSTANCE, *SEMANTIC))
    if key is None:
        problem = f"holds {', '.join(held) or 'nothing'}, none of {', '.join(INSTANCE)}"
        raise InputFileError(path, problem, REMEDY)
    labels = _checked(path, held[key], key)
    kind = _first(held, SEMANTIC) or key
    kinds = _checked(path, held[kind], kind)
    if len(kinds) != len(labels):
        problem = f"{key} has {len(labels):,} elements, {kind} {len(kinds):,}"
        raise InputFileError(path, problem, "both need one label an element")
    table = held.get(_first(held, NAMES) or "", np.zeros(0, "U1"))
    said = [_name(str(name)) for name in table] if table.dtype.kind == "U" else []
    pairs = zip(*(values.tolist() for values in _majority(labels, kinds)), strict=True)
    names = {label: said[k] for label, k in pairs if 0 <= k < len(said) and said[k]}
    own = any(k in held for k in ("points", "vertices", "xyz"))
    geometry = read_npz(path) if own else _beside(path, len(labels))
    return Masks(path, file_digest([path]), labels, names, geometry)


def _of_ply(path: Path) -> Masks:
    known = (*INSTANCE, *SEMANTIC)
    loaded, columns = read_ply_columns(path, known)
    if not columns:
        loaded, columns = read_ply_columns(path, known, element="face")
    key = _first(columns, known)
    if key is None:
        remedy = f"call an integer property {', '.join(INSTANCE[:4])} or the like"
        raise InputFileError(path, "no property of its vertices or triangles is a label", remedy)
    return Masks(path, file_digest([path]), _checked(path, columns[key], key), {}, loaded)


def _of_folder(folder: Path) -> Masks:
    inner = folder / "instance_seg"
    manifest = find_manifest(inner if inner.is_dir() else folder, FOLDER_SUFFIXES)
    paths = [e.path for e in manifest.entries]
    loaded = [load_geometry(p, DEFAULT_MAX_BYTES) for p in paths]
    names = [e.name or e.path.stem for e in manifest.entries]
    if _painted(loaded):
        labels, called = _instances(loaded, names)
        return Masks(folder, file_digest(paths), labels, called, loaded[0])
    solid = [bool(len(p.faces)) for p in loaded]
    if any(solid) != all(solid):
        cloud = paths[solid.index(False)]
        raise InputFileError(cloud, "is a cloud among meshes", "give all parts as one or the other")
    sizes = [len(p.faces) or len(p.vertices) for p in loaded]
    return _pieces(folder, paths, names, sizes, join(loaded))


def _pieces(
    path: Path, files: list[Path], names: Sequence[str], sizes: Sequence[int], whole: Loaded
) -> Masks:
    """A part for each of ``sizes`` faces or points of the whole."""
    called = {i: known for i, name in enumerate(names) if (known := _name(name))}
    return Masks(path, file_digest(files), np.repeat(np.arange(len(sizes)), sizes), called, whole)


def _painted(loaded: list[Loaded]) -> bool:
    """True if these are one cloud in several colours, black outside the part, as PartSLIP writes
    it."""
    first = loaded[0].vertices
    return all(
        not len(p.faces)
        and p.colors is not None
        and not p.colors[:, :3].any(axis=1).all()
        and p.vertices.shape == first.shape
        and np.allclose(p.vertices, first, equal_nan=True)
        for p in loaded
    )


def _instances(loaded: list[Loaded], names: list[str]) -> tuple[Labels, dict[int, str]]:
    labels = np.full(len(loaded[0].vertices), -1, np.int64)
    called: list[str] = []
    for piece, name in zip(loaded, names, strict=True):
        assert piece.colors is not None
        colors = piece.colors[:, :3].astype(np.int64) @ [1 << 16, 1 << 8, 1]
        for color in np.unique(colors[colors > 0]):
            labels[colors == color] = len(called)
            called.append(_name(name))
    return labels, {i: name for i, name in enumerate(called) if name}


def _beside(path: Path, count: int) -> Loaded | None:
    """The mesh or cloud that labels were written for, as public code lays it out: of the same name
    (P3-SAM without ``_face_ids``), in ``ply/`` (PartField) or in ``vis_pcd/`` (SAMPart3D)."""
    stem = path.stem.removesuffix("_face_ids")
    above = path.parent.parent
    folders = (path.parent, above / "ply", above.parent / "vis_pcd" / path.parent.name)
    for file in (folder / f"{stem}{end}" for folder in folders for end in (".ply", ".glb", ".obj")):
        if file.is_file():
            loaded = load_geometry(file, DEFAULT_MAX_BYTES)
            if count in (len(loaded.faces), len(loaded.vertices), loaded.polygons):
                return loaded
    return None


# --- values


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
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
    """Name of a part; "" for names such as ``mesh_3``. ``door@0`` is an instance of door."""
    plain = "".join(c for c in re.sub(r"@\d+$", "", text) if c.isprintable()).strip()
    return "" if _UNNAMED.fullmatch(plain) else plain


def _checked(path: Path, value: Any, what: str) -> Labels:
    """(N,) labels; P3-SAM's -2, a face that no sample hit, is -1."""
    array = np.asarray(value)
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    if array.ndim != 1 or array.dtype.kind not in "iufb" or not len(array):
        empty = "is empty" if array.shape == (0,) else f"has shape {array.shape} of {array.dtype}"
        raise InputFileError(path, f"{what} {empty}", "one whole number a face or point is needed")
    numbers = array.astype(np.float64)
    least = -2 if path.stem.endswith("_face_ids") else -1
    right = (numbers == np.round(numbers)) & (numbers >= least) & (numbers < 2**52)
    if not right.all():
        at = int(np.argmin(right))
        remedy = "labels are whole numbers from 0, and -1 for none"
        raise InputFileError(path, f"{what} is {array[at]} at element {at:,}", remedy)
    return np.maximum(numbers, -1).astype(np.int64)


# --- from one surface to another


def _on_elements(asset: Asset, masks: Masks) -> Labels:
    """(E,) labels of the asset's elements, -1 for none."""
    own = None
    if len(masks.labels) == asset.element_count:
        own = masks.labels
    elif asset.mesh is not None and len(masks.labels) == len(asset.mesh.vertices):
        own = _of_faces(masks.labels, asset.mesh.faces)
    if masks.geometry is None and own is None:
        masks = replace(masks, geometry=_whole_faces(asset, len(masks.labels)))
    if masks.geometry is None:
        if own is None:
            count, kind = len(masks.labels), asset.element_kind
            raise InputFileError(
                masks.path,
                f"has {count:,} labels for {asset.element_count:,} {kind}s of {asset.name}",
                f"give one a {kind}, or put the mesh or cloud that they belong to "
                f"beside it as {masks.path.stem}.ply",
            )
        return own
    points, labels = _labelled_points(masks, masks.geometry)
    element = np.arange(asset.element_count)
    surface = asset.element_centers
    if asset.mesh is not None:
        surface, element = _spread(asset.mesh, element)
    placed, distance = _placed(points, surface, asset)
    diagonal = asset.diagonal or 1.0
    if distance > APART * diagonal:
        if own is not None:
            return own
        away = f"{100 * distance / diagonal:.0f} % of the object's size away on average"
        problem = f"its geometry isn't that of {asset.name}: {away}"
        raise InputFileError(masks.path, problem, "give masks of the same object")
    tree = KDTree(placed)
    spacing = float(np.median(tree.query(placed[:: max(1, len(placed) // 2000)], k=2)[0][:, 1]))
    far, nearest = tree.query(surface)
    found = np.where(far > max(REACH * diagonal, 3 * spacing), -1, labels[nearest])
    return _majority(element, found)[1]  # every element has a point


def _whole_faces(asset: Asset, count: int) -> Loaded | None:
    """The asset's own file where it has ``count`` faces, some of which were cut into triangles."""
    path = None if asset.source is None or asset.mesh is None else asset.source.path
    if path is None or path.suffix.lower() not in (".obj", ".ply") or not path.is_file():
        return None
    loaded = load_geometry(path, DEFAULT_MAX_BYTES)
    return loaded if loaded.polygons == count else None


def _labelled_points(masks: Masks, held: Loaded) -> tuple[FloatArray, Labels]:
    """(P, 3) points of the masks' own geometry, and (P,) their labels."""
    labels, vertices = masks.labels, held.vertices.astype(np.float64)
    if held.polygon is not None and len(labels) == held.polygons:
        labels = labels[held.polygon]
    if len(labels) not in (len(held.faces), len(vertices)):
        counts = f"{len(held.faces):,} faces and {len(vertices):,} vertices"
        problem = f"has {len(labels):,} labels for {counts}"
        raise InputFileError(masks.path, problem, "one label for each is needed")
    if not len(held.faces):
        kept = np.isfinite(vertices).all(axis=1)
        return vertices[kept], labels[kept]
    if len(labels) != len(held.faces):
        labels = _of_faces(labels, held.faces)
    return _spread(to_mesh(Loaded(np.nan_to_num(vertices), held.faces)), labels)


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
    """Each group and the value that most of its members have, -1 only where all have it."""
    pairs, counts = np.unique(np.stack([groups, values], 1), axis=0, return_counts=True)
    order = np.lexsort((-counts, pairs[:, 1] < 0, pairs[:, 0]))
    kept, first = np.unique(pairs[order, 0], return_index=True)
    return kept, pairs[order[first], 1]


def _placed(points: FloatArray, surface: FloatArray, asset: Asset) -> tuple[FloatArray, float]:
    """The masks' points in the asset's frame, and their mean distance from its surface."""
    some = points[np.random.default_rng(0).permutation(len(points))[:3000]]
    tree, diagonal = KDTree(surface), asset.diagonal or 1.0
    costs: list[tuple[float, FloatArray]] = []
    for matrix in _placements(points, asset):
        far = tree.query(some @ matrix[:3, :3].T + matrix[:3, 3])[0]
        costs.append((float(np.minimum(far, 0.1 * diagonal).mean()), matrix))
    best = min(cost for cost, _ in costs) + _MARGIN * diagonal
    cost, matrix = next(each for each in costs if each[0] <= best)
    return points @ matrix[:3, :3].T + matrix[:3, 3], cost


def _placements(points: FloatArray, asset: Asset) -> Iterator[FloatArray]:
    """(4, 4) from the masks' file to the asset: as the asset was read, other axes up, and each of
    them fitted to the box, as networks normalise what they see."""
    source = asset.source
    unit, own = (1.0, "z") if source is None else (source.unit_scale, source.up_axis)
    shift = (0.0, 0.0, 0.0) if source is None else source.shift
    turns = [turned_up(axis)[:3, :3] for axis in sorted(get_args(UpAxis), key=lambda a: a != own)]
    for turn in turns:
        yield affine(unit * turn, np.negative(shift))
    for turn in turns:
        turned = points @ turn.T
        scale = asset.diagonal / (float(np.linalg.norm(np.ptp(turned, axis=0))) or 1.0)
        middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
        yield affine(scale * turn, asset.bounds.mean(axis=0) - scale * middle)
