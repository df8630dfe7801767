"""Jobs that prepare geometry for the browser: an opened asset, its parts while joints move, light
in its surface, and thumbnails of the queue's objects.
"""

from __future__ import annotations

import hashlib
import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.stats import binned_statistic_2d

from app.server.part_tasks import PartSource
from app.server.prepare_tasks import removed_of
from app.server.segmenting_tasks import source_regions
from app.server.tasks import ReadOptions, arrays_of, asset_of, pixels_of, stamp, working_copy
from model.core.articulated_object import ArticulatedObject, Part, Prediction
from model.core.asset import Asset, ElementKind, Source
from model.core.files import draft_of, file_sha256
from model.core.geometry import Mesh, PointCloud
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.geometry import drawing
from model.geometry.ambient_light import CreaseEdges, crease_edges, is_plain, with_ambient_occlusion
from model.geometry.crop import crop
from model.geometry.display import display_asset, thin
from model.geometry.levelling import box_yaw
from model.geometry.prepare import moved
from model.geometry.sampling import face_colors, sample_surface
from model.io.masks import read_masks, with_masks
from model.io.model_files import is_model, model_of
from model.io.open_asset import open_asset as read_asset
from model.io.write import face_order, mesh_to_glb
from sessions.checks import NAME_LIMIT, clipped
from sessions.provenance import MASKS

_FRONT_POINTS, _FRONT_CELLS = 20_000, 32
"""Points in which a front is looked for, and cells along the longest side of a side's picture."""
_MOST_PROTRUSION = 0.1
"""Largest protrusion of a scan that counts, a share of its size: what is deeper is its inside."""
_FILE = "light-1.npz"
"""In the folder of the asset's arrays; another number where the light is computed otherwise."""


@dataclass(frozen=True, eq=False)
class LitMesh:
    """A displayed mesh without a texture, lit.

    Attributes:
        glb: with the light in its vertex colors.
        glb_order: (T,) displayed face that each of its triangles lies in.
        edges: lines; their faces are displayed ones.
    """

    glb: bytes
    glb_order: npt.NDArray[np.int32]
    edges: CreaseEdges


def lit_mesh(folder: Path) -> LitMesh | None:
    """The displayed mesh of an asset with its light, from the cache where it was computed before;
    None where a cloud, a texture or vertex colors are displayed."""
    mesh = display_asset(asset_of(folder)).mesh
    if mesh is None or not len(mesh.faces) or not is_plain(mesh):
        return None
    found = _stored(folder, mesh)
    if found is None:
        _store(folder, mesh)
        found = _stored(folder, mesh)
    if found is None:
        return None
    shaded, face = found
    order = face[face_order(shaded, matt=True)]
    return LitMesh(mesh_to_glb(shaded, matt=True), order, crease_edges(mesh))


def lit_parts(folder: Path, mesh: Mesh, labels: npt.NDArray[np.integer]) -> dict[int, Mesh] | None:
    """The lit mesh of each part by the (D,) labels of the displayed faces; None without light."""
    found = _stored(folder, mesh)
    if found is None:
        return None
    shaded, face = found
    of_triangle = labels[face]
    return {int(p): shaded.take_faces(of_triangle == p) for p in np.unique(of_triangle)}


def _store(folder: Path, mesh: Mesh) -> None:
    shaded, face = with_ambient_occlusion(mesh)
    assert shaded.vertex_colors is not None
    with draft_of(folder / _FILE) as draft:
        np.savez(
            draft,
            vertices=shaded.vertices,
            faces=shaded.faces,
            material=shaded.face_material,
            colors=shaded.vertex_colors,
            face=face,
            count=len(mesh.faces),
        )


def _stored(folder: Path, mesh: Mesh) -> tuple[Mesh, npt.NDArray[np.int32]] | None:
    """The refined mesh and the displayed face of each of its faces; None where there is none."""
    with suppress(FileNotFoundError, KeyError, ValueError, BadZipFile):
        with np.load(folder / _FILE) as kept:
            arrays = {name: kept[name] for name in kept.files}
        if int(arrays["count"]) != len(mesh.faces):
            return None
        white = tuple(
            replace(m, base_color=(255, 255, 255, m.base_color[3])) for m in mesh.materials
        )
        shaded = Mesh(
            vertices=arrays["vertices"],
            faces=arrays["faces"],
            face_material=arrays["material"],
            materials=white,
            vertex_colors=arrays["colors"],
        )
        return shaded, arrays["face"]
    return None


HEAVY_ELEMENTS = 150_000
"""More than the browser shows; ray structures of worse ones take a second in one step."""
HEAVY_PIXELS = 4096 * 4096
"""Pixels of textures; to decode more takes over a tenth of a second."""
REMOVED_SHOWN = 30_000
"""Points that show what is left out."""


@dataclass(frozen=True, eq=False)
class OpenedAsset:
    """The part of an open asset that the server keeps.

    Attributes:
        folder: memory-mapped arrays of the asset, shared by the workers.
        source: the file, and how it was read.
        display_vertices, display_faces: the displayed mesh, or None.
        display_points: the displayed cloud, or None.
        display_colors: (D, 3) of its points, or of the displayed faces.
        element: (D,) source element of each displayed face or point.
        area: (D,) float32, m², of each displayed face; None for a cloud.
        glb: the displayed mesh with its materials, z up, else None.
        glb_order: (D,) displayed face of each triangle of ``glb``; None for a cloud.
        part_names: names by part id where the file is in parts.
        source_parts: part of the file → reference of its stored elements and their number.
        source_labels: reference of the same as stored (E,) labels.
        source_joints: the joints of the file.
        display_confidence: (D,) of the displayed cloud's points, or None.
        removed: (R, 3) some of what is left out, to be shown.
        masks: what the tool is called that took the parts from masks, their file in it, or "".
        heavy: whether work on it takes so long that others must not wait for it.
    """

    name: str
    folder: Path
    source: Source
    element_kind: ElementKind
    element_count: int
    bounds: npt.NDArray[np.float64]
    element: npt.NDArray[np.int32]
    area: npt.NDArray[np.float32] | None = None
    display_vertices: npt.NDArray[np.float32] | None = None
    display_faces: npt.NDArray[np.int32] | None = None
    display_points: npt.NDArray[np.float32] | None = None
    display_colors: npt.NDArray[np.uint8] | None = None
    glb: bytes | None = None
    glb_order: npt.NDArray[np.int32] | None = None
    part_names: tuple[str, ...] = ()
    source_parts: dict[int, tuple[str, int]] = field(default_factory=dict)
    source_labels: str | None = None
    source_joints: Prediction | None = None
    category: str | None = None
    warnings: tuple[str, ...] = ()
    front: tuple[float, float, float] = (0.0, -1.0, 0.0)
    display_confidence: npt.NDArray[np.float32] | None = None
    removed: npt.NDArray[np.float32] | None = None
    masks: str = ""
    heavy: bool = False

    @property
    def display_centers(self) -> npt.NDArray[np.floating]:
        """(D, 3) displayed points, or middles of the displayed faces."""
        if self.display_points is not None:
            return self.display_points
        assert self.display_vertices is not None and self.display_faces is not None
        return self.display_vertices[self.display_faces].mean(1)

    @cached_property
    def height(self) -> float:
        """Metres from its lowest to its highest element, but for the few outermost ones."""
        low, high = np.percentile(self.display_centers[:, 2], [0.05, 99.95])
        return float(high - low)

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal in metres."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))


@dataclass(frozen=True, eq=False)
class PartPayload:
    """One part as the browser draws it while joints move."""

    part: int
    glb: bytes | None
    points: npt.NDArray[np.float32] | None
    colors: npt.NDArray[np.uint8] | None
    vertices: npt.NDArray[np.float32] | None = None
    faces: npt.NDArray[np.int32] | None = None

    @property
    def shape(self) -> npt.NDArray[np.float32]:
        """(N, 3) its vertices, or the points of a cloud."""
        shape = self.points if self.vertices is None else self.vertices
        return np.zeros((0, 3), np.float32) if shape is None else shape


def open_asset(
    path: Path,
    workspace: Path,
    options: ReadOptions,
    masks: Path | None = None,
    progress: Progress = no_progress,
) -> OpenedAsset:
    """Read ``path``, save its arrays for the other workers, and prepare its display.

    Args:
        masks: of another system; they take the place of parts and joints that the file tells.
    """
    progress(0.02, "Reading")
    asset, folder = working_copy(path, workspace, options, progress)
    unchanged = options.left_out is None and not options.face_cuts
    origin = ""
    if masks is not None and unchanged:
        progress(0.7, f"Reading {masks.name}")
        read = read_masks(masks)
        cut = with_masks(working_copy(path, workspace, options.as_read)[0], read)
        parts, names = cut.element_part, cut.part_names
        origin = MASKS + read.origin
        asset = replace(asset, element_part=parts, part_names=names, tree=None)
    progress(0.8, "Preparing the picture")
    opened = replace(_opened(asset, folder, path), masks=origin)
    if options.left_out is not None:
        gone = removed_of(path, workspace, options).element_centers.astype(np.float32)
        opened = replace(opened, removed=gone[thin(gone, REMOVED_SHOWN)])
    if asset.element_part is None or not unchanged:
        return opened
    return replace(
        opened,
        source_parts=source_regions(asset, workspace),
        source_labels=arrays_of(workspace).put(asset.element_part.astype(np.int16)),
        source_joints=_source_joints(asset, path),
    )


def _source_joints(asset: Asset, path: Path) -> Prediction | None:
    if asset.tree is None:
        return None
    file = model_of(path) if path.is_dir() else path
    return Prediction.of_file(path.name if file is None else file.name, asset.tree)


def _opened(asset: Asset, folder: Path, path: Path) -> OpenedAsset:
    shown = display_asset(asset)
    source = asset.source or Source(path, "")
    part_names, category, warnings = _short_names(asset)
    mesh, cloud = shown.mesh, shown.cloud
    return OpenedAsset(
        name=asset.name,
        folder=folder,
        source=replace(source, path=path),
        element_kind=asset.element_kind,
        element_count=asset.element_count,
        bounds=np.asarray(asset.bounds),
        element=np.asarray(shown.element, np.int32),
        area=None if mesh is None else mesh.face_areas.astype(np.float32),
        display_vertices=None if mesh is None else mesh.vertices.astype(np.float32),
        display_faces=None if mesh is None else np.asarray(mesh.faces),
        display_points=None if cloud is None else np.asarray(cloud.points),
        display_colors=_colors(cloud) if cloud is not None else face_colors(mesh)[:, :3],  # type: ignore[arg-type]
        glb=None if mesh is None else mesh_to_glb(mesh, matt=True),
        glb_order=None if mesh is None else face_order(mesh, matt=True),
        part_names=part_names,
        category=category,
        warnings=(*asset.warnings, *warnings),
        display_confidence=None if cloud is None else cloud.confidence,
        heavy=asset.element_count > HEAVY_ELEMENTS or pixels_of(asset) > HEAVY_PIXELS,
        front=_front_of(mesh, cloud),
    )


def _short_names(asset: Asset) -> tuple[tuple[str, ...], str | None, tuple[str, ...]]:
    """Return names and category cut to the allowed length, and a warning where they were longer."""
    names = tuple(clipped(n, NAME_LIMIT) for n in asset.part_names)
    category = None if asset.category is None else clipped(asset.category, NAME_LIMIT)
    longest = max(map(len, (*asset.part_names, asset.category or "")), default=0)
    if longest <= NAME_LIMIT:
        return names, category, ()
    warning = f"a name or the category has {longest:,} characters: cut to {NAME_LIMIT}"
    return names, category, (warning,)


def _front_of(mesh: Mesh | None, cloud: PointCloud | None) -> tuple[float, float, float]:
    if mesh is not None:
        return front_direction(mesh.vertices, mesh.faces)
    assert cloud is not None
    return front_direction(cloud.points)


def front_direction(
    points: npt.ArrayLike, faces: npt.ArrayLike | None = None
) -> tuple[float, float, float]:
    """Return the horizontal direction of the front: the broad side with the most protrusions.

    Handles, knobs and frames protrude from a front, and a scan has points where the camera stood.
    The sides are those of the tightest upright box; a near tie goes to -y, glTF's front.

    Args:
        points: (N, 3) of a cloud, or the vertices of a mesh; +z up.
        faces: (F, 3) of the mesh.
    """
    points, most = np.asarray(points, np.float64), _MOST_PROTRUSION if faces is None else math.inf
    if faces is not None and (mesh := Mesh(points, np.asarray(faces))).face_areas.any():
        points = sample_surface(mesh, _FRONT_POINTS, np.random.default_rng(0))[0].points
    points = points[:: max(1, len(points) // _FRONT_POINTS)]
    best, score = (0.0, -1.0, 0.0), 0.0
    turn = box_yaw(points[:, :2])
    for angle in turn + np.array([-0.5, 0.0, 1.0, 0.5]) * np.pi:
        x, y = float(np.cos(angle)), float(np.sin(angle))
        seen = points @ np.array([[x, -y, 0], [y, x, 0], [0, 0, 1]])  # outwards, aside, upwards
        low, high = np.percentile(seen, (1, 99), axis=0)  # a scan's outliers don't count
        size = np.maximum(high - low, 1e-9)
        cells = np.ceil(_FRONT_CELLS * size[1:] / size.max()).astype(int)
        (out, across, up), area = seen.T, np.stack([low, high], 1)[1:]
        outer = binned_statistic_2d(across, up, out, "max", cells, area).statistic
        known = outer[np.isfinite(outer)]
        protrusion = np.ptp(np.percentile(known, (50, 99.5))) / size.max() if len(known) else 0.0
        share = float(np.mean(high[0] - out < 0.15 * size[0]))
        now = share * float(size[1]) * min(float(protrusion), most)
        if now > 1.05 * score:
            best, score = (x, y, 0.0), now
    return best


def _colors(cloud: PointCloud) -> npt.NDArray[np.uint8]:
    """Return the scan's colours, or a height ramp where it has none."""
    if cloud.colors is not None:
        return np.asarray(cloud.colors)
    z = cloud.points[:, 2]
    t = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    low, high = np.array([96, 110, 130.0]), np.array([214, 218, 222.0])
    return (low + t[:, None] * (high - low)).astype(np.uint8)


def part_payloads(
    source: PartSource, element: npt.NDArray[np.int32], progress: Progress = no_progress
) -> list[PartPayload]:
    """Return each part's displayed geometry."""
    shown = display_asset(asset_of(source.folder))
    labels = arrays_of(source.workspace).get(source.labels)[element]
    lit = None if shown.mesh is None else lit_parts(source.folder, shown.mesh, labels)
    out = []
    parts = [int(p) for p in np.unique(labels)]
    for k, part in enumerate(parts):
        progress(k / len(parts), "Cutting the picture into parts")
        mine = labels == part
        if shown.mesh is not None:
            mesh = shown.mesh.take_faces(mine)
            out.append(
                PartPayload(
                    part,
                    mesh_to_glb(mesh if lit is None else lit[part], matt=True),
                    None,
                    None,
                    mesh.vertices.astype(np.float32),
                    np.asarray(mesh.faces),
                )
            )
        else:
            assert shown.cloud is not None
            cloud = shown.cloud.take(mine)
            out.append(PartPayload(part, None, np.asarray(cloud.points), _colors(cloud)))
    return out


SIZE = (208, 156)
"""Pixels of a thumbnail: a card of the gallery on a sharp screen."""
_VIEW = drawing.View(width=3 * SIZE[0] // 2, height=3 * SIZE[1] // 2)
_ASIDE = 0.6
"""Radians from an object's front to the camera."""


def draw_thumbnail(path: Path, workspace: Path, options: ReadOptions) -> Path:
    """Draw the object of ``path`` as read with some options, unless that was done before.

    Returns:
        The WebP file in the workspace, named after the content.

    Raises:
        ArtiworldError: where the file can't be read.
    """
    frame, left_out = options.frame, options.left_out
    shown = ("front", options.up_axis, options.unit_scale, frame, left_out, _content(path))
    key = hashlib.sha256(repr(shown).encode()).hexdigest()[:24]
    target = workspace / "thumbnails" / f"{key}.webp"
    if target.exists():
        return target
    asset = read_asset(path, up_axis=options.up_axis, unit_scale=options.unit_scale)
    if left_out is not None:
        gone = arrays_of(workspace).get(left_out)
        asset = crop(asset, ~np.isin(np.arange(asset.element_count), gone))
    asset = moved(asset, frame.object_from_read)
    whole = Part("link_0", asset.mesh, asset.cloud)
    obj = ArticulatedObject("thumbnail", (whole,), KinematicTree(("link_0",), ()))
    x, y, _ = _front_of(asset.mesh, asset.cloud)
    view = replace(_VIEW, azimuth=math.atan2(y, x) - _ASIDE)
    image = drawing.draw(obj, view=view).resize(SIZE, Image.Resampling.LANCZOS)
    with draft_of(target) as draft:
        image.save(draft, "WEBP", quality=80)
    return target


def _content(path: Path) -> str:
    """A key of what a file holds; of folders, and files that name others, names and times."""
    if path.is_dir() or is_model(path) or path.suffix.lower() in (".obj", ".gltf"):
        return repr((str(path), stamp(path)))
    return file_sha256(path)
