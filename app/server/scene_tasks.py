"""Jobs for scenes, with the simplified geometry of their assets for the browser, cached on disk;
see :mod:`app.server.tasks`.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.server import part_tasks, prepare_tasks, segmenting_tasks, tasks
from app.server.part_tasks import PartSource
from app.server.prompt_file import beside, read_prompts
from app.server.tasks import ReadOptions, arrays_of, stamp, working_copy
from model.core.articulated_object import Part, Prediction
from model.core.asset import MAX_PARTS, Asset, Source
from model.core.errors import ArtiworldError, CommandError
from model.core.files import draft_of
from model.core.progress import Progress, no_progress, scaled_progress
from model.geometry.crop import ROOM_METRES
from model.geometry.display import decimate, spacing, thin
from model.geometry.sampling import face_colors
from model.geometry.splitting import split
from model.io.urdf.model import save_declared
from model.io.write import write_cloud, write_mesh
from model.scenes.articulable_finders import FinderOptions, default_cache, load_finder
from model.scenes.asset_parts import (
    AssetParts,
    LeftForAnnotator,
    asset_digest,
    bounds_of,
    index_assets,
    known_parts,
    masses_at,
    scaled,
    scaled_shapes,
    size_factors,
    whole,
)
from model.scenes.convert import decide
from model.scenes.jobs import FAILED
from model.scenes.registry import read_scene
from model.scenes.scene import Decision, SceneObject, SceneProblem
from model.scenes.unpacking import unpack
from model.segmentation.prompts import BASE, Click
from sessions.checks import NAME_LIMIT, clipped

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SceneItem:
    """One object of a scene, before anybody works on it.

    Attributes:
        obj: the object in the scene.
        decision: the finder's decision.
        path: its asset, or None.
        copy: folder of its working copy, made or not; None without an asset.
        truth: whether the asset is known to move; None where that is unknown.
        problem: why its geometry inside the scene's file can't be used, else "".
    """

    obj: SceneObject
    decision: Decision
    path: Path | None = None
    copy: Path | None = None
    truth: bool | None = None
    problem: str = ""

    @property
    def category(self) -> str | None:
        """Its category, or None."""
        return self.decision.kind or self.obj.category


@dataclass(frozen=True, eq=False)
class OpenedScene:
    """A scene that was read."""

    name: str
    reader: str
    items: tuple[SceneItem, ...]
    problems: tuple[SceneProblem, ...]
    ambiguous: frozenset[str]


@dataclass(frozen=True, eq=False)
class Prepared:
    """A working copy's parts and joints before a person looks at it.

    Attributes:
        reason: why it is left for the annotator, else "".
        names: part → name.
        clicks, regions: prompts; a region is (part, stored elements, their number).
        labels, counts: result of these prompts; None and empty without prompts.
        segmenter: name of the segmenter.
        prediction: the predicted joints, or None.
    """

    reason: str = ""
    names: tuple[tuple[int, str | None], ...] = ()
    clicks: tuple[Click, ...] = ()
    regions: tuple[tuple[int, str, int], ...] = ()
    labels: str | None = None
    counts: tuple[tuple[int, int], ...] = ()
    segmenter: str = ""
    seconds: float = 0.0
    prediction: Prediction | None = None


# --- reading ----------------------------------------------------------------------------------


def read(
    path: Path,
    folders: Sequence[Path],
    format: str | None,
    finder: str,
    finder_url: str | None,
    workspace: Path,
    progress: Progress = no_progress,
) -> OpenedScene:
    """Read a scene, find its assets, and decide which of its objects are articulable."""
    progress(0.1, "reading")
    if format is None and path.suffix.lower() == ".ply":
        format = "scan"  # labelled or not
    scene = read_scene(path, format)
    index = index_assets(folders)
    chosen = load_finder(finder, FinderOptions(finder_url, cache=default_cache()), progress)
    stamps: dict[Path, Any] = {}
    items: list[SceneItem] = []
    home = workspace / "scenes" / f"inside-{_name_of(path)}"
    inside = unpack(scene, home)
    for o in decide(scene, index, chosen, inside):
        copy = None
        if o.path is not None:
            if o.path not in stamps:
                stamps[o.path] = _identity(o.path, home)
            identity = (stamps[o.path], o.obj.scale.tolist(), o.obj.fit)
            key = hashlib.sha256(repr(identity).encode()).hexdigest()[:12]
            copy = workspace / "scenes" / f"{_plain(o.path.stem)}-{key}"
        problem = o.reason if o.state == FAILED else ""
        items.append(SceneItem(o.obj, o.decision, o.path, copy, o.truth, problem))
    return OpenedScene(scene.name, scene.reader, tuple(items), scene.problems, index.ambiguous)


def _identity(path: Path, home: Path) -> tuple[Any, ...]:
    """Return a key of an asset's files; those inside a scene are rewritten at each opening."""
    if path.is_relative_to(home):
        return str(path.relative_to(home)), asset_digest(path)
    return str(path.resolve()), tasks.stamp(path)


def _name_of(path: Path) -> str:
    key = hashlib.sha256(repr((str(path.resolve()), tasks.stamp(path))).encode()).hexdigest()[:12]
    return f"{_plain(path.stem)}-{key}"


def _plain(stem: str) -> str:
    return "".join(c if c.isalnum() and c.isascii() else "_" for c in stem)[:40]


# --- working copies ---------------------------------------------------------------------------


def make_working_copy(item: SceneItem) -> str:
    """Make the item's working copy; returns why its parts are unknown, or "".

    Raises:
        InputFileError: where the asset can't be read.
    """
    assert item.path is not None and item.copy is not None
    reason, known = "", None
    try:
        known = known_parts(item.path)
        parts = known.parts
        if len(parts) > MAX_PARTS:
            parts, reason = (), f"its {len(parts)} parts are too many"
    except LeftForAnnotator as left:
        parts, reason = (), str(left)
    if _is_whole(item.copy):
        return reason
    whole_one = not parts
    parts = parts or (whole(item.path),)
    factors = size_factors(item.obj, parts)
    with draft_of(item.copy, _is_whole) as draft:
        draft.mkdir()
        _write_copy(scaled(parts, factors), item.category, draft, unnamed=whole_one)
        if known is not None and not whole_one:
            _write_declared_physics(known, factors, draft)
    return reason


def _is_whole(copy: Path) -> bool:
    return (copy / "object.json").is_file()


def _write_copy(
    parts: tuple[Part, ...], category: str | None, folder: Path, *, unnamed: bool
) -> None:
    entries: list[dict[str, str]] = []
    for i, part in enumerate(parts):
        if part.mesh is not None:
            file = write_mesh(part.mesh, folder / f"link_{i}.obj")[0].name
        else:
            assert part.cloud is not None
            file = write_cloud(part.cloud, folder / f"link_{i}.ply")[0].name
        name = "base" if unnamed else part.name
        entries.append({"file": file} if name is None else {"file": file, "name": name})
    description: dict[str, Any] = {"format": 1, "parts": entries}
    if category:
        description["category"] = category
    (folder / "object.json").write_text(json.dumps(description), encoding="utf-8")


def _write_declared_physics(
    known: AssetParts, factors: npt.NDArray[np.float64], folder: Path
) -> None:
    """Write the masses and collision shapes that the asset declares, by the copy's links."""
    link = {part.link: f"link_{i}" for i, part in enumerate(known.parts)}
    masses, shapes = masses_at(known, factors), scaled_shapes(known.shapes, factors)
    save_declared(
        folder,
        {link[k]: i for k, i in masses.items() if k in link},
        {link[k]: s for k, s in shapes.items() if k in link},
    )


def prepare_for_picking(
    item: SceneItem, workspace: Path, progress: Progress = no_progress
) -> prepare_tasks.Removal | None:
    """Make a working copy to pick objects out of; returns floor and walls where it is a room."""
    assert item.copy is not None
    make_working_copy(item)
    asset, folder = tasks.working_copy(item.copy, workspace, tasks.ReadOptions(), progress)
    if np.ptp(np.asarray(asset.bounds)[:, :2], axis=0).max() <= ROOM_METRES:
        return None
    try:
        return prepare_tasks.floor_and_walls(workspace, None, folder, progress)
    except CommandError:
        return None  # it has none


def prepare(
    item: SceneItem,
    workspace: Path,
    segmenter: str,
    predictor: str,
    progress: Progress = no_progress,
) -> Prepared:
    """Make the working copy, segment it where its parts are known, and predict its joints.

    Parts are known from a prompt file beside the asset (``NAME.prompts.json``), from the asset
    itself, or where its connected components are few.
    """
    assert item.path is not None and item.copy is not None
    progress(0.02, "reading")
    reason = make_working_copy(item)
    asset, folder = tasks.working_copy(item.copy, workspace, tasks.ReadOptions())
    if asset.source is not None and any(asset.source.shift):
        raise CommandError("its asset lies too far from its own origin")
    prompts = beside(item.path)
    if prompts is not None:
        cut = _cut_by_prompts(prompts, item, asset, folder, workspace, segmenter)
    elif not reason and asset.element_part is not None:
        cut = _cut_by_source(asset, asset.element_part, workspace)
    else:
        return Prepared(reason)
    progress(0.4, "predicting")
    assert cut.labels is not None
    names = {part: name for part, name in cut.names if name}
    source = PartSource(folder, workspace, cut.labels, names, item.category, asset.name)
    span = scaled_progress(progress, 0.4, 1.0)
    prediction = part_tasks.predict(source, predictor, (), 0, progress=span)
    if prediction.tree is None or not any(j.moves for j in prediction.tree.joints):
        why = "; ".join(prediction.problems) or "no reason was given"
        return replace(cut, reason=f"no joint was predicted: {why}")
    return replace(cut, prediction=prediction)


def _cut_by_prompts(
    file: Path, item: SceneItem, asset: Asset, folder: Path, workspace: Path, segmenter: str
) -> Prepared:
    assert item.path is not None
    prompts = read_prompts(file)
    factors = size_factors(item.obj, (whole(item.path),))
    clicks: list[Click] = []
    for prompt in prompts.prompts.items:
        if not isinstance(prompt, Click):
            raise CommandError(f"{file}: regions refer to elements of another file; use clicks")
        x, y, z = (float(v) for v in np.asarray(prompt.position) * factors)
        clicks.append(Click((x, y, z), prompt.part, prompt.positive))
    answer = segmenting_tasks.segment(
        folder, workspace, segmenter, tuple(clicks), "", None, keep=False
    )
    names = tuple((p, prompts.names.get(p)) for p in sorted({c.part for c in clicks} - {BASE}))
    return Prepared(
        names=names,
        clicks=tuple(clicks),
        labels=answer.labels,
        counts=tuple(answer.counts.items()),
        segmenter=answer.segmenter,
        seconds=answer.seconds,
    )


def _cut_by_source(asset: Asset, element_part: npt.NDArray[np.int32], workspace: Path) -> Prepared:
    """Take the asset's own parts; the base is a region, too, so the segmenter guesses nothing."""
    labels = element_part.astype(np.int16)
    regions = segmenting_tasks.source_regions(asset, workspace)
    names = tuple(
        (i, clipped(asset.part_names[i], NAME_LIMIT) if i < len(asset.part_names) else None)
        for i in sorted(regions)
    )
    return Prepared(
        names=names,
        regions=tuple((i, ref, count) for i, (ref, count) in sorted(regions.items())),
        labels=tasks.arrays_of(workspace).put(labels),
        counts=tuple((i, count) for i, (_, count) in sorted(regions.items())),
        segmenter="source",
    )


BATCH_SECONDS = 0.4
"""Time after which a job returns the shapes it has, so that the scene fills up."""


@dataclass(frozen=True, eq=False)
class Shape:
    """The drawn geometry of a rigid object, in its own frame, metres.

    Attributes:
        bounds: (2, 3) of the whole geometry, not of the drawn one; of a scan without outliers.
        vertices: (V, 3), or the points of a cloud.
        faces: (F, 3); None for a cloud.
        colors: (F, 3) of a mesh, (V, 3) of a cloud; None where the source has none.
        spacing: approximate distance between a cloud's points, metres.
    """

    bounds: FloatArray
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.uint32] | None
    colors: npt.NDArray[np.uint8] | None = None
    spacing: float = 0.0


BOX = Shape(
    np.array([[-0.5] * 3, [0.5] * 3]),
    np.array([[i >> k & 1 for k in range(3)] for i in range(8)], np.float32) - 0.5,
    np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
              [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]], np.uint32),
)  # fmt: skip
"""A cube of 1 m; vertex i is at the upper end of axis k where bit k of i is set."""


def placed(
    item: SceneItem, shapes: Mapping[Path, Shape | str]
) -> tuple[Shape, FloatArray, FloatArray] | None:
    """Return an object's shape, its (4, 4) pose in the scene and its (3,) scale: a vertex v is at
    ``pose @ (scale * v)``. None where the shape isn't known (yet)."""
    obj = item.obj
    if obj.box is not None:
        return BOX, obj.world_from_object, np.asarray(obj.box)
    shape = None if item.path is None else shapes.get(item.path)
    if not isinstance(shape, Shape):
        return None
    at = obj.placed(shape.bounds)
    return shape, at.world_from_asset, at.scale


@dataclass(frozen=True, eq=False)
class DrawnParts:
    """The parts of a working copy as the browser draws them.

    Attributes:
        labels: reference of their labels.
        folder: the arrays of the working copy.
        source: the working copy's source.
        shapes: link → shape.
    """

    labels: str
    folder: Path
    source: Source
    shapes: dict[str, Shape]


def shapes(
    paths: Sequence[Path], workspace: Path, max_faces: int, progress: Progress = no_progress
) -> dict[Path, Shape | str]:
    """Return the shapes of as many assets as there is time for; the error of unreadable ones."""
    end = time.perf_counter() + BATCH_SECONDS
    out: dict[Path, Shape | str] = {}
    for path in paths:
        # A message of its own for each: the fraction then says at which one it stands.
        progress(len(out) / len(paths), f"{path.name} ({len(out) + 1} of {len(paths)})")
        try:
            out[path] = _shape_of(path, workspace, max_faces)
        except ArtiworldError as error:
            out[path] = str(error)
        if time.perf_counter() > end:
            break
    return out


def _shape_of(path: Path, workspace: Path, max_faces: int) -> Shape:
    identity = ("without strays", str(path.resolve()), stamp(path), max_faces)
    key = hashlib.sha256(repr(identity).encode()).hexdigest()[:24]
    kept = workspace / "cache" / "shapes" / f"{key}.npz"
    try:
        with np.load(kept, allow_pickle=False) as data:
            return Shape(
                data["bounds"],
                data["vertices"],
                data.get("faces"),
                data.get("colors"),
                float(data["spacing"]),
            )
    except (OSError, ValueError, KeyError, EOFError):
        pass
    part = whole(path)
    shape = replace(shape_of_part(part, max_faces), bounds=bounds_of((part,)))
    arrays = {k: v for k, v in vars(shape).items() if v is not None}
    with draft_of(kept) as draft:
        np.savez(draft, **arrays)
    return shape


def shape_of_part(part: Part, max_faces: int) -> Shape:
    """Return a part with at most ``max_faces`` faces, each of one colour."""
    bounds = np.asarray(part.bounds, np.float64)
    if part.mesh is None:
        assert part.cloud is not None
        cloud = part.cloud.take(thin(part.cloud.points, 2 * max_faces))
        points = np.asarray(cloud.points, np.float32)
        colors = None if cloud.colors is None else np.asarray(cloud.colors, np.uint8)[:, :3]
        return Shape(bounds, points, None, colors, spacing(points))
    mesh = part.mesh if len(part.mesh.faces) <= max_faces else decimate(part.mesh, max_faces)[0]
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = np.asarray(mesh.vertices[used], np.float32)
    colors = face_colors(mesh)[:, :3]
    return Shape(bounds, vertices, faces.reshape(-1, 3).astype(np.uint32), colors)


def drawn_parts(
    copy: Path, workspace: Path, labels: str, max_faces: int, options: ReadOptions
) -> DrawnParts:
    """Return the drawn parts of a working copy, cut by stored labels."""
    asset, folder = working_copy(copy, workspace, options)
    assert asset.source is not None
    cut = split(asset, arrays_of(workspace).get(labels))
    budget = max(200, max_faces // max(1, len(cut)))
    made = {part.link: shape_of_part(part, budget) for part in cut}
    return DrawnParts(labels, folder, asset.source, made)
