"""Complete scanned parts: closed surfaces, thick doors, trays of drawers, openings of bodies.

Scans show fronts. This makes up what is behind them, so that a door is a board, a drawer can hold
something, and the body has room for it. Only parts that are clouds are completed; their points stay
as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh, PointCloud, merged_clouds
from model.core.joint import Joint, canonical_axis_sign, motion
from model.core.progress import Progress, attempt, no_progress
from model.geometry.cleaning import denoised, noise_level
from model.geometry.display import thin
from model.geometry.reconstruct import (
    box,
    closed_solid,
    colored_by,
    largest,
    mesh_of_scan,
    spacing_of,
)
from model.geometry.sampling import estimate_normals

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

Array = npt.NDArray[Any]

MAX_POINTS = 40_000
"""Most points of the whole object; larger scans are thinned, which bounds the time."""
FEW = 300
"""Points below which a part keeps its reconstructed surface."""
NOISE = 0.15
"""Noise level of a cloud, see :func:`~model.geometry.cleaning.noise_level`, that is taken off."""
LONE, PLANAR = 0.3, 0.03
"""Share of the usual number of neighbours below which a point is in the air, unless so small a
share of its neighbours' variance is off their plane."""
LEAST = 800
"""Points of a part that are not thinned."""
BOARD = 0.02
"""Metres, the usual thickness of furniture's boards; less for panels below 16 cm."""
SMALL = 0.05
"""Share of the object's diagonal: no board of a small object is thicker."""
GAP = 0.004
"""Share of the object's diagonal between completion and body: the error of convex shapes."""
FLAT = 0.25
"""A panel's depth over its smaller side up to which it is one."""
HOST = 0.3
"""Depth behind a door over its smaller side from which it is a container's and gets an opening."""
PULL = 0.3
"""Travel over a front's smaller side from which it is a drawer's: buttons move less."""
SWING = 9
"""Poses in which a panel's made-up side must not meet the body."""

SURFACE, THICKNESS, TRAY, OPENING = "closed surface", "thickness", "tray", "opening"
"""Kinds of completion, see :attr:`~model.core.articulated_object.Part.completed`."""


@dataclass(frozen=True, eq=False)
class Panel:
    """The front of a door, lid or drawer.

    Attributes:
        joint: that moves it.
        frame: (4, 4) object from panel; x and y along the front, z outwards, 0 at the front.
        outline: in x and y, without holes.
        low, high: (2,) corners of the outline.
        thickness: metres, of the front; what was seen of it is not cut off.
        reach: metres that handles stand out.
        drawer: whether it slides outwards.
    """

    joint: Joint
    frame: npt.NDArray[np.float64]
    outline: CrossSection
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    thickness: float
    reach: float
    drawer: bool

    def local(self, points: Array) -> Array:
        """(N, 3) points in the panel's frame."""
        return (points - self.frame[:3, 3]) @ self.frame[:3, :3]

    def placed(self, solid: Manifold) -> Manifold:
        """A solid of the panel's frame in that of the object."""
        return solid.transform(self.frame[:3])

    def prism(self, outline: CrossSection, low: float, high: float) -> Manifold:
        """The prism over an outline between two depths, object frame."""
        return self.placed(outline.extrude(high - low).translate((0.0, 0.0, low)))


def complete(obj: ArticulatedObject, progress: Progress = no_progress) -> ArticulatedObject:
    """Return the object with closed surfaces of the parts that are clouds.

    Parts that can't be completed stay as they are, with a remark. The same object gives the same
    surfaces.
    """
    remarks: list[str] = []
    solids = attempt(remarks, "closing the surfaces", lambda: _solids(obj, progress), {})
    first, *others = (_completed(p, solids.get(p.link)) for p in obj.parts)
    progress(1.0, "completed")
    first = replace(first, remarks=(*first.remarks, *remarks))
    return replace(obj, parts=(first, *others))


def _solids(
    obj: ArticulatedObject, progress: Progress
) -> dict[str, tuple[Manifold, tuple[str, ...]]]:
    """Link → closed surface and the kinds of its completion."""
    clouds = _clouds(obj, progress)
    if not clouds:
        return {}
    diagonal = float(
        np.linalg.norm(np.ptp(np.concatenate([c.points for c in clouds.values()]), axis=0))
    )
    gap = GAP * diagonal
    panels = {
        link: panel
        for link, joint in obj.tree.joint_of.items()
        if link in clouds and (panel := panel_of(clouds[link], canonical_axis_sign(joint), gap))
    }
    solids: dict[str, tuple[Manifold, tuple[str, ...]]] = {}
    for i, (link, cloud) in enumerate(clouds.items()):
        progress(0.2 + 0.7 * i / len(clouds), f"closing {link}")
        fronts = [_front_points(clouds[k], p) for k, p in panels.items() if p.joint.parent == link]
        solid = _closed(cloud, panels.get(link), fronts, min(BOARD, SMALL * diagonal))
        if solid is not None:
            solids[link] = solid, (THICKNESS if link in panels else SURFACE,)
    progress(0.9, "making room")
    _free_knobs(obj, clouds, solids, gap)
    for link, panel in panels.items():
        parent = panel.joint.parent
        others = [c.points for k, c in clouds.items() if k not in (link, parent)]
        host = solids.get(parent)
        room = 0.0 if parent not in clouds else _room(panel, clouds[parent], others, gap)
        if panel.drawer and link in solids:
            tray = _tray(panel, room, gap)
            if tray is not None:
                solids[link] = solids[link][0] + tray, (*solids[link][1], TRAY)
        if host is not None and link in solids:
            opened = largest(host[0] - _cut(panel, room, gap))
            if opened is not None:
                solids[parent] = opened, tuple(dict.fromkeys((*host[1], OPENING)))
    return solids


def _clouds(obj: ArticulatedObject, progress: Progress) -> dict[str, PointCloud]:
    """Link → a clean cloud with normals, of the parts that are clouds with enough points.

    Normals are estimated on all parts together: a sheet alone doesn't tell its outer side.
    """
    scanned = {p.link: p.cloud for p in obj.parts if p.cloud is not None and len(p.cloud) >= FEW}
    if not scanned:
        return {}
    progress(0.0, "cleaning")
    total = sum(map(len, scanned.values()))
    small = {
        k: c.take(thin(c.points, max(LEAST, MAX_POINTS * len(c) // total)))
        for k, c in scanned.items()
    }
    points = np.concatenate([c.points for c in small.values()])  # evenly dense
    part = np.repeat(np.arange(len(small)), [len(c) for c in small.values()])
    index = np.flatnonzero(~_lone(points))
    points, part = points[index], part[index]
    progress(0.05, "noise and normals")
    if noise_level(points) > NOISE:
        points = denoised(points)
    normals = estimate_normals(PointCloud(points)).normals
    assert normals is not None
    out: dict[str, PointCloud] = {}
    for i, link in enumerate(small):
        mine = part == i
        flat = np.ptp(points[mine], axis=0) if mine.any() else np.zeros(3)
        if mine.sum() >= FEW // 3 and np.sort(flat)[1] > 1e-6:
            out[link] = PointCloud(points[mine], normals[mine])
    return out


def _lone(points: Array) -> Array:
    """(N,) whether evenly spread points are in the air: few others are near, and they are on no
    plane of equally sparse ones, as on a surface that was seen at a slant."""
    from scipy.spatial import KDTree

    tree = KDTree(points)
    around = tree.query_ball_point(points, 6 * spacing_of(points), return_length=True)
    lone = np.asarray(around < LONE * np.median(around))
    distance, near = map(np.asarray, tree.query(points, k=min(12, len(points))))
    alike = distance[:, -1] < 1.5 * np.median(distance[near, -1], axis=1)
    local = points[near[lone]].astype(float)
    local -= local.mean(axis=1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", local, local))
    lone[lone] = ~alike[lone] | (spread[:, 0] > PLANAR * spread.sum(axis=1))
    return lone


def panel_of(cloud: PointCloud, joint: Joint, gap: float) -> Panel | None:
    """Find the front of a door, a lid or a drawer; None where the part is no such panel.

    Args:
        cloud: of the part, with normals.
        joint: of the part, positive where it opens.
        gap: metres; the outline is not more precise.
    """
    points, normals = cloud.points.astype(float), cloud.normals
    assert normals is not None
    if not joint.moves:
        return None
    axis = np.asarray(joint.axis)
    outward = _outward(points, normals)
    if outward is None:
        return None
    along = float(outward @ axis)
    drawer = joint.slides and along > 0.8
    if drawer:
        outward = axis
    elif abs(along) > 0.5:
        return None  # a knob, a button, a wheel
    elif joint.rotates:
        outward = outward - along * axis
        outward /= np.linalg.norm(outward)
    up = axis if joint.rotates else np.array([0.0, 0.0, 1.0])
    if abs(up @ outward) > 0.8:
        up = np.array([0.0, 1.0, 0.0])
    right = np.cross(up, outward)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(outward, right), outward], axis=1)
    flat = points @ turn
    level = float(np.median(flat[normals @ outward > 0.7, 2]))
    height = flat[:, 2] - level
    low, high = np.percentile(flat[:, :2], (0.5, 99.5), axis=0)
    side = float((high - low).min())
    if side <= 0 or np.mean(np.abs(height) < FLAT * side / 2) < 0.6:
        return None
    depth = float(-np.percentile(height, 1))
    thickness = max(min(BOARD, side / 8), min(depth, FLAT * side))
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = turn, turn @ [0.0, 0.0, level]
    outline = _outline(flat[height > -thickness][:, :2], low, high, gap)
    reach = float(height.max()) + thickness
    return Panel(joint, frame, outline, low, high, thickness, reach, drawer)


def _outward(points: Array, normals: Array) -> Array | None:
    """The direction in which most of a flat part faces; None where it faces both ways."""
    away = points - points.mean(axis=0)
    thin_side = np.linalg.svd(away[:: max(1, len(away) // 20_000)], full_matrices=False)[2][2]
    facing = normals @ thin_side
    if facing.sum() < 0:
        thin_side, facing = -thin_side, -facing
    front = facing > 0.8
    if front.mean() < 0.3:
        return None
    mean = normals[front].mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean), float)


def _outline(flat: Array, low: Array, high: Array, cell: float) -> CrossSection:
    """The outline of points (N, 2): a rectangle where they nearly fill one."""
    from manifold3d import CrossSection, FillRule
    from scipy.ndimage import binary_closing, binary_fill_holes

    cell = max(cell, 2.0 * spacing_of(np.column_stack([flat, np.zeros(len(flat))])))
    inside = flat[((flat >= low) & (flat <= high)).all(axis=1)]
    index = np.floor((inside - low) / cell).astype(int) + 3
    mask = np.zeros(index.max(axis=0) + 4, bool)
    mask[tuple(index.T)] = True
    mask = np.asarray(binary_fill_holes(binary_closing(mask, iterations=2)))
    rectangle = CrossSection([np.array([low, (high[0], low[1]), high, (low[0], high[1])])])
    if mask.sum() * cell**2 > 0.88 * rectangle.area():
        return rectangle
    corner = low - 3 * cell
    cells = [
        corner + (i + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])) * cell for i in np.argwhere(mask)
    ]
    # Rounded by opening and closing: cells are squares.
    shape = CrossSection(cells, FillRule.NonZero).offset(cell).offset(-2 * cell).offset(cell)
    return shape.simplify(cell / 4) ^ rectangle


def _front_points(cloud: PointCloud, panel: Panel) -> PointCloud:
    """The points of a panel without handles: the body is behind them."""
    height = panel.local(cloud.points)[:, 2]
    return cloud.take(np.abs(height) < panel.thickness)


def _closed(
    cloud: PointCloud, panel: Panel | None, fronts: Sequence[PointCloud], wall: float
) -> Manifold | None:
    """The closed solid of a part.

    Args:
        panel: where it is one.
        fronts: points of the panels on it.
        wall: metres.
    """
    if panel is None:
        return closed_solid(merged_clouds([cloud, *fronts]), wall)
    # Filled up to beyond the outline, the surface is cut at the panel's border.
    outward = panel.frame[:3, 2]
    plane = np.array([*outward, panel.thickness / 3 - outward @ panel.frame[:3, 3]])
    front = closed_solid(_filled(cloud, panel), 2 * panel.thickness, plane)
    board = panel.prism(panel.outline, -panel.thickness, -panel.thickness / 2)
    if front is None:
        return None
    return largest((front ^ panel.prism(panel.outline, -panel.thickness, panel.reach)) + board)


def _filled(cloud: PointCloud, panel: Panel) -> PointCloud:
    """The panel's points, with more of them in holes and in a seam around the outline."""
    from scipy.spatial import KDTree

    flat = panel.local(cloud.points)
    front = flat[(np.abs(flat[:, 2]) < panel.thickness)]
    step = max(spacing_of(cloud.points), float((panel.high - panel.low).max()) / 300)
    seam = 4 * step + panel.thickness
    lines = [np.arange(panel.low[k] - seam, panel.high[k] + seam, step) for k in range(2)]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    away, near = KDTree(front[:, :2]).query(grid, k=min(8, len(front)))
    empty = away[:, 0] > 1.5 * step
    made = np.column_stack([grid, np.median(front[near, 2], axis=1)])[empty]
    points = made @ panel.frame[:3, :3].T + panel.frame[:3, 3]
    normals = np.tile(panel.frame[:3, 2], (len(points), 1))
    return merged_clouds([cloud, PointCloud(points.astype(np.float32), normals.astype(np.float32))])


def _room(panel: Panel, body: PointCloud, others: Sequence[Array], gap: float) -> float:
    """Metres behind a panel's front up to the body's far wall, or to what was seen before it."""
    depth = -panel.local(body.points)[:, 2]
    side = float((panel.high - panel.low).min())
    room = float(np.percentile(depth, 99)) - min(BOARD, side / 8) - gap
    assert body.normals is not None
    seen = body.points[body.normals @ panel.frame[:3, 2] > 0.5]  # of the inside
    area = float(np.prod(panel.high - panel.low))
    for points in (seen, *others):
        flat = panel.local(points)
        margin = 0.1 * (panel.high - panel.low)
        inside = ((flat[:, :2] > panel.low + margin) & (flat[:, :2] < panel.high - margin)).all(1)
        behind = -flat[inside & (flat[:, 2] < -panel.thickness - 2 * gap), 2]
        cell = max(gap, float(np.sqrt(area)) / 30)
        covered = len(np.unique(np.floor(flat[inside & (flat[:, 2] < 0), :2] / cell), axis=0))
        if len(behind) and covered * cell**2 > 0.1 * area:
            room = min(room, float(np.percentile(behind, 5)) - gap)
    return room


def _inset(panel: Panel, gap: float) -> float:
    """Metres from a front's edge to the opening behind it."""
    return gap + min(BOARD / 2, 0.05 * float((panel.high - panel.low).min()))


def _tray(panel: Panel, room: float, gap: float) -> Manifold | None:
    """An open box behind a drawer's front; None where there is no room for one."""
    wall = min(BOARD / 2, 0.05 * float((panel.high - panel.low).min()))
    inset = _inset(panel, gap) + gap
    low, high = panel.low + inset, panel.high - inset
    high[1] = low[1] + 0.8 * (high[1] - low[1])
    depth = room - gap
    upright = panel.frame[2, 1] > 0.8
    travel = panel.joint.motion_range[1]
    if not upright or depth < 3 * panel.thickness or travel < PULL * (high - low).min():
        return None
    front = -panel.thickness / 2
    outer = box(np.array([*low, -depth]), np.array([*high, front]))
    inner = box(
        np.array([*(low + wall), wall - depth]),
        np.array([high[0] - wall, high[1] + wall, -panel.thickness]),
    )
    return panel.placed(outer - inner)


def _cut(panel: Panel, room: float, gap: float) -> Manifold:
    """Solid to remove from a panel's body: its own place, its path, and the opening behind it."""
    from manifold3d import JoinType, Manifold, OpType

    wide = panel.outline.offset(gap, JoinType.Miter)
    back = -panel.thickness - gap
    cuts = [panel.prism(wide, back, panel.reach)]
    lower, upper = panel.joint.motion_range
    if not panel.drawer:
        made = panel.prism(wide, back, -gap)
        cuts += [
            made.transform(motion(panel.joint, q)[:3]) for q in np.linspace(lower, upper, SWING)
        ]
    side = float((panel.high - panel.low).min())
    if room > (3 * panel.thickness if panel.drawer else HOST * side):
        hole = panel.outline.offset(-_inset(panel, gap), JoinType.Miter)
        cuts.append(panel.prism(hole, -room, 0.0))
    return Manifold.batch_boolean(cuts, OpType.Add)


def _free_knobs(
    obj: ArticulatedObject,
    clouds: Mapping[str, PointCloud],
    solids: dict[str, tuple[Manifold, tuple[str, ...]]],
    gap: float,
) -> None:
    """Keep knobs and wheels within a cylinder about their axis, and their parent out of it."""
    for joint in obj.tree.joints:
        child, parent = joint.child, joint.parent
        if not joint.rotates or child not in solids or THICKNESS in solids[child][1]:
            continue
        axis = np.asarray(joint.axis)
        side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        side /= np.linalg.norm(side)
        frame = np.column_stack([side, np.cross(axis, side), axis, joint.origin])
        local = (clouds[child].points - frame[:, 3]) @ frame[:, :3]
        radius = float(np.percentile(np.linalg.norm(local[:, :2], axis=1), 95)) + gap / 2
        if np.linalg.norm(local[:, :2].mean(axis=0)) > 0.3 * radius:
            continue  # it swings
        low, high = np.percentile(local[:, 2], (1, 99))
        low, high = low - gap, high + gap
        own = largest(solids[child][0] ^ _cylinder(low, high, radius, frame))
        if own is None:
            continue
        solids[child] = own, solids[child][1]
        pocket = _cylinder(low - gap / 2, high + gap / 2, radius + gap / 2, frame)
        host = solids.get(parent)
        rest = None if host is None else largest(host[0] - pocket)
        if host is not None and rest is not None:
            solids[parent] = rest, host[1]


def _cylinder(low: float, high: float, radius: float, frame: Array) -> Manifold:
    """A cylinder about z between two heights, placed by (3, 4) ``frame``."""
    from manifold3d import Manifold

    made = Manifold.cylinder(high - low, radius, circular_segments=64)
    return made.translate((0.0, 0.0, low)).transform(frame)


def _completed(part: Part, made: tuple[Manifold, tuple[str, ...]] | None) -> Part:
    """A part with its solid as a mesh; its cloud stays."""
    if part.cloud is None:
        return part
    mesh = None if made is None else _mesh(made[0], part.cloud)
    if mesh is None or made is None:
        remark = f"{part.link} could not be completed: too few points, or no closed surface"
        return replace(part, remarks=(*part.remarks, remark))
    return replace(part, mesh=mesh, completed=made[1])


def _mesh(solid: Manifold, cloud: PointCloud) -> Mesh | None:
    """The solid's surface; colours of the nearest points, and of the median far from all."""
    from scipy.spatial import KDTree

    out = solid.to_mesh()
    vertices = np.asarray(out.vert_properties, np.float64)[:, :3]
    faces = np.asarray(out.tri_verts, np.int32)
    if not len(faces) or not np.isfinite(vertices).all():
        return None
    if cloud.colors is None:
        return Mesh(vertices, faces)
    rgba = colored_by(vertices, cloud)
    near = KDTree(cloud.points).query(vertices, k=min(3, len(cloud)))[0]
    far = near.max(axis=1) > BOARD  # one near point may be in the air
    rgba[far, :3] = np.median(cloud.colors, axis=0)
    return mesh_of_scan(vertices, faces, rgba)


def completed_arrays(obj: ArticulatedObject) -> dict[str, Array]:
    """Geometry that :func:`complete` added to an object, as arrays for a cache."""
    out: dict[str, Array] = {}
    for i, part in enumerate(obj.parts):
        if part.completed and part.mesh is not None:
            out[f"{i}_words"] = np.array(part.completed)
            out[f"{i}_vertices"], out[f"{i}_faces"] = part.mesh.vertices, part.mesh.faces
            if part.mesh.vertex_colors is not None:
                out[f"{i}_colors"] = part.mesh.vertex_colors
    return out


def completed_with(obj: ArticulatedObject, arrays: Mapping[str, Array]) -> ArticulatedObject:
    """Return the object that :func:`complete` made :func:`completed_arrays` of."""
    parts: list[Part] = []
    for i, part in enumerate(obj.parts):
        words = arrays.get(f"{i}_words")
        if words is None:
            parts.append(_completed(part, None))
            continue
        mesh = mesh_of_scan(
            arrays[f"{i}_vertices"], arrays[f"{i}_faces"], arrays.get(f"{i}_colors")
        )
        parts.append(replace(part, mesh=mesh, completed=tuple(map(str, words))))
    return replace(obj, parts=tuple(parts))


def as_scanned(parts: Sequence[Part]) -> tuple[Part, ...]:
    """The parts without the meshes that were made of their clouds."""
    return tuple(p if p.cloud is None else replace(p, mesh=None, completed=()) for p in parts)
