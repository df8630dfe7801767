"""Assembly of objects: parts made of solids, joints by construction, and the rest pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Material, Mesh
from model.core.joint import Joint, JointType, canonical_axis_sign
from model.core.tree import KinematicTree
from model.data.procedural.materials import UNPAINTED, Palette, Surface
from model.data.procedural.shapes import Solid, Vector


@dataclass(frozen=True, eq=False)
class ProceduralObject:
    """An object with its true joints, made by a family.

    Attributes:
        object: parts (meshes, names), tree and category; metres, +z up, standing on z = 0, the
            front towards -y; q = 0 is how it stands there.
        pieces: link -> (F,) int32, the solid that each face of the part belongs to.
        piece_names: link -> what those solids are (panel, handle, …).
    """

    object: ArticulatedObject
    pieces: Mapping[str, npt.NDArray[np.int32]]
    piece_names: Mapping[str, tuple[str, ...]]

    @property
    def category(self) -> str:
        """PartNet-Mobility's name of the category."""
        return self.object.category or ""


@dataclass(frozen=True, eq=False)
class _Piece:
    solid: Solid
    surface: Surface
    name: str
    grain: int | None
    frame: npt.NDArray[np.float64] | None
    flipped: bool


@dataclass(eq=False)
class Body:
    """A rigid part while it is being built. Solids are given in the object's frame."""

    link: str
    name: str | None
    pieces: list[_Piece] = field(default_factory=list)

    def add(
        self,
        solid: Solid,
        surface: Surface,
        piece: str = "panel",
        *,
        grain: int | None = None,
        fit_to: Solid | None = None,
        flipped: bool = False,
    ) -> Solid:
        """Add a closed solid.

        Args:
            piece: what it is, for semantics and over-segmentation.
            grain: axis (0..2) along which the texture runs; None is the longest side.
            fit_to: for fitted pictures, the solid whose extent the picture covers.
            flipped: the fitted picture's top is at the low end (a closed laptop's screen).
        """
        extent = None if fit_to is None else fit_to.bounds
        self.pieces.append(_Piece(solid, surface, piece, grain, extent, flipped))
        return solid

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner of the solids added so far."""
        each = np.stack([p.solid.bounds for p in self.pieces])
        return np.stack([each[:, 0].min(0), each[:, 1].max(0)])


class Builder:
    """Collects the bodies and joints of one object.

    Args:
        category: PartNet-Mobility's name.
        rng: of the family; here it decides only where textures lie.
        palette: surfaces of the modules.
    """

    def __init__(
        self, category: str, rng: np.random.Generator, palette: Palette = UNPAINTED
    ) -> None:
        self.category, self.rng, self.palette = category, rng, palette
        self._bodies: list[Body] = []
        self._joints: list[Joint] = []
        self._helpers: list[str] = []

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The joints made so far."""
        return tuple(self._joints)

    def base(self, name: str) -> Body:
        """The base part; made first."""
        return self._body(name)

    def hinge(
        self, name: str, parent: Body, axis: Vector, origin: Vector, lower: float, upper: float
    ) -> Body:
        """A part that turns between ``lower`` and ``upper`` radians."""
        return self._jointed(name, parent.link, "revolute", axis, origin, lower, upper)

    def spin(self, name: str, parent: Body, axis: Vector, origin: Vector) -> Body:
        """A part that turns without end."""
        return self._jointed(name, parent.link, "continuous", axis, origin, None, None)

    def slide(
        self,
        name: str,
        parent: Body,
        axis: Vector,
        lower: float,
        upper: float,
        origin: Vector = (0.0, 0.0, 0.0),
    ) -> Body:
        """A part that slides between ``lower`` and ``upper`` metres."""
        return self._jointed(name, parent.link, "prismatic", axis, origin, lower, upper)

    def screw(self, name: str, parent: Body, axis: Vector, origin: Vector, travel: float) -> Body:
        """A part that turns and comes off: continuous to a helper link, then prismatic.

        PartNet-Mobility writes bottle caps and office chairs' seats so.
        """
        helper = f"helper_{len(self._helpers)}"
        self._helpers.append(helper)
        self._joints.append(
            _joint(f"joint_{helper}", "continuous", parent.link, helper, axis, origin, None, None)
        )
        return self._jointed(name, helper, "prismatic", axis, origin, 0.0, travel)

    def _body(self, name: str | None) -> Body:
        body = Body(f"link_{len(self._bodies)}", name)
        self._bodies.append(body)
        return body

    def _jointed(
        self,
        name: str,
        parent: str,
        kind: JointType,
        axis: Vector,
        origin: Vector,
        lower: float | None,
        upper: float | None,
    ) -> Body:
        body = self._body(name)
        index = body.link.removeprefix("link_")
        self._joints.append(
            _joint(f"joint_{index}", kind, parent, body.link, axis, origin, lower, upper)
        )
        return body

    def build(self, rest: Mapping[str, float] | None = None) -> ProceduralObject:
        """The finished object.

        Args:
            rest: link -> joint value at which it is left standing (an open door); that pose is
                q = 0 of the result and its limits count from there.
        """
        parts, pieces, names = [], {}, {}
        for body in self._bodies:
            mesh, index = _mesh(body, self.rng)
            parts.append(Part(body.link, mesh=mesh, name=body.name))
            pieces[body.link] = index
            names[body.link] = tuple(p.name for p in body.pieces)
        links = tuple(b.link for b in self._bodies) + tuple(self._helpers)
        tree = KinematicTree(links, tuple(self._joints))
        obj = ArticulatedObject(self.category.lower(), tuple(parts), tree, self.category)
        if rest:
            q = {tree.joint_of[link].name: value for link, value in rest.items()}
            obj = at_rest(obj, q)
        return ProceduralObject(obj, pieces, names)


def _joint(
    name: str,
    kind: JointType,
    parent: str,
    child: str,
    axis: Vector,
    origin: Vector,
    lower: float | None,
    upper: float | None,
) -> Joint:
    a, o = (tuple(float(x) for x in v) for v in (axis, origin))
    return canonical_axis_sign(Joint(name, kind, parent, child, a, o, lower, upper))  # type: ignore[arg-type]


def at_rest(obj: ArticulatedObject, q: Mapping[str, float]) -> ArticulatedObject:
    """The same object left standing at ``q``: that pose becomes q = 0, limits are shifted."""
    pose, values = obj.tree.pose(q), obj.tree.joint_values(q)
    parts = tuple(p.moved(pose[p.link]) for p in obj.parts)
    joints = []
    for j in obj.tree.joints:
        m, value = pose[j.parent], values.get(j.name, 0.0)
        axis, origin = m[:3, :3] @ np.asarray(j.axis), m[:3, :3] @ np.asarray(j.origin) + m[:3, 3]
        joints.append(
            replace(
                j,
                axis=tuple(axis),
                origin=tuple(origin),
                lower=None if j.lower is None else j.lower - value,
                upper=None if j.upper is None else j.upper - value,
            )
        )
    return replace(obj, parts=parts, tree=KinematicTree(obj.tree.links, tuple(joints)))


def _mesh(body: Body, rng: np.random.Generator) -> tuple[Mesh, npt.NDArray[np.int32]]:
    """One mesh of all the body's solids, its faces in their order, and each face's solid."""
    materials: list[Material] = []
    slots: dict[int, int] = {}
    vertices, faces, uvs, material, piece = [], [], [], [], []
    count = 0
    for number, p in enumerate(body.pieces):
        v, f, uv = _split(p, rng)
        key = id(p.surface.material)
        if key not in slots:
            slots[key] = len(materials)
            materials.append(p.surface.material)
        vertices.append(v)
        faces.append(f + count)
        uvs.append(uv)
        material.append(np.full(len(f), slots[key], np.int32))
        piece.append(np.full(len(f), number, np.int32))
        count += len(v)
    mesh = Mesh(
        np.concatenate(vertices),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(material),
        tuple(materials),
        np.concatenate(uvs).astype(np.float32),
    )
    return mesh, np.concatenate(piece)


def _split(
    piece: _Piece, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """Vertices (split at texture seams), faces, and texture coordinates."""
    solid, surface = piece.solid, piece.surface
    if surface.material.texture is None:
        return solid.vertices, solid.faces, np.zeros((len(solid.vertices), 2))
    triangles = solid.vertices[solid.faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-12)
    side = np.repeat(np.argmax(np.abs(normal) + np.array([0.0, 1e-6, 2e-6]), axis=1), 3)
    corners = solid.faces.reshape(-1)
    _, first, inverse = np.unique(corners * 3 + side, return_index=True, return_inverse=True)
    vertices = solid.vertices[corners[first]]
    faces = inverse.reshape(-1, 3).astype(np.int32)
    return vertices, faces, _texture_coordinates(piece, vertices, side[first], rng)


def _texture_coordinates(
    piece: _Piece,
    vertices: npt.NDArray[np.float64],
    side: npt.NDArray[np.intp],
    rng: np.random.Generator,
) -> npt.NDArray[np.float64]:
    """Planar along the dominant axis of each face; the grain runs along u."""
    low, high = piece.solid.bounds if piece.frame is None else piece.frame
    extent = high - low
    if piece.surface.globe:
        away = vertices - (low + high) / 2
        angle = np.abs(np.arctan2(away[:, 0], -away[:, 1])) / np.pi
        height = away[:, 2] / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        # Mirrored halves leave no seam.
        return np.stack([angle, 0.5 + np.arcsin(np.clip(height, -1, 1)) / np.pi], 1)
    if piece.surface.fit:
        t = (vertices - low) / np.maximum(extent, 1e-9)
        # Fitted pictures show on the widest side: fronts on xz, tops on xy.
        thin = int(np.argmin(extent))
        u, v = ((1, 2), (0, 2), (0, 1))[thin]
        uv = t[:, [u, v]]
        return uv * [1, -1] + [0, 1] if piece.flipped else uv
    grain = int(np.argmax(extent)) if piece.grain is None else piece.grain
    shift = rng.random(2)
    out = np.zeros((len(vertices), 2))
    for axis in range(3):
        rows = side == axis
        others = [a for a in range(3) if a != axis]
        if grain in others and others[0] != grain:
            others.reverse()
        out[rows] = vertices[rows][:, others] / piece.surface.tile + shift
    return out
