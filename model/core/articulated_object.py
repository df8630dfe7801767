"""Parts and a tree that agree, and what a predictor answers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from model.core.affordance import Affordance
from model.core.errors import GeometryError, KinematicsError
from model.core.inertial import Inertial
from model.core.joint import Joint
from model.core.mesh import Mesh
from model.core.point_cloud import PointCloud
from model.core.shapes import Shape
from model.core.tree import KinematicTree


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid part in the object's rest frame.

    Attributes:
        link: name of its link (``link_0``).
        mesh, cloud: its geometry; at least one.
        name: what it is in the field's words (door, drawer, lid, …), or None.
        remarks: what was passed over on reading the source it comes from (points that are no
            numbers, a missing texture), human-readable.
        completed: kinds of completion behind the cloud's surface, see
            :func:`model.geometry.completion.complete`.
    """

    link: str
    mesh: Mesh | None = None
    cloud: PointCloud | None = None
    name: str | None = None
    remarks: tuple[str, ...] = ()
    completed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.mesh is None and self.cloud is None:
            raise GeometryError(f"part {self.link!r} needs a mesh or a cloud")

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner."""
        return (self.mesh if self.mesh is not None else self.cloud).bounds  # type: ignore[union-attr]


def remarks_of(parts: Iterable[Part]) -> tuple[str, ...]:
    """The remarks of all parts, each once: parts of one source share theirs."""
    return tuple(dict.fromkeys(remark for part in parts for remark in part.remarks))


@dataclass(frozen=True, eq=False)
class SegmentedObject:
    """Input of a predictor: the rigid parts of one object, in one frame.

    The order of the parts says nothing about which one is the base.

    Attributes:
        inertials: link → mass properties that the source declares; no predictor reads them.
        shapes: link → collision shapes that the source declares, object frame.
    """

    name: str
    parts: tuple[Part, ...]
    category: str | None = None
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.parts:
            raise GeometryError(f"{self.name}: an object needs at least one part")
        links = [p.link for p in self.parts]
        twice = sorted({n for n in links if links.count(n) > 1})
        if twice:
            raise GeometryError(f"{self.name}: parts with the same link name: {', '.join(twice)}")

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) lowest and highest corner of all parts."""
        each = np.stack([p.bounds for p in self.parts])
        return np.stack([each[:, 0].min(0), each[:, 1].max(0)])


@dataclass(frozen=True, eq=False)
class ArticulatedObject:
    """Parts and tree that agree: every part is a link, every other link is a helper.

    Attributes:
        inertials: link → mass properties where the source tells them; links that aren't there
            have what exporters work out.
        shapes: link → collision shapes, object frame, where the source tells them; for other parts
            they are made.

    Raises:
        KinematicsError: where they don't.
    """

    name: str
    parts: tuple[Part, ...]
    tree: KinematicTree
    category: str | None = None
    inertials: Mapping[str, Inertial] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Shape, ...]] = field(default_factory=dict)
    affordances: tuple[Affordance, ...] = ()

    def __post_init__(self) -> None:
        links, owned = set(self.tree.links), {p.link for p in self.parts}
        problems = [f"part {link!r} has no link in the tree" for link in sorted(owned - links)]
        problems += [
            f"link {link!r} has no part; helper links must not begin with 'link_'"
            for link in sorted(links - owned)
            if link.startswith("link_")
        ]
        if problems:
            raise KinematicsError(problems)

    def pose(self, q: Mapping[str, float]) -> dict[str, npt.NDArray[np.float64]]:
        """Link → (4, 4), as :meth:`KinematicTree.pose`."""
        return self.tree.pose(q)


@dataclass(frozen=True)
class Prediction:
    """A predictor's answer, or the joints that a file tells. Bad model text never raises: it
    becomes ``problems``.

    Attributes:
        tree: None where nothing usable came out.
        problems: human-readable errors and doubts.
        confidence: child link → 0..1 for its joint.
        backend: predictor and version; of a file's joints "file" and its name.
        raw_text: the model's own words, "" for a predictor without any.
        notes: child link → human-readable explanation of the joint.
        file: name of the file that declares the joints; None where a predictor answered.
        alternatives: child link → other joints that it may have, likeliest first.
    """

    tree: KinematicTree | None
    problems: tuple[str, ...] = ()
    confidence: Mapping[str, float] = field(default_factory=dict)
    backend: str = ""
    seed: int = 0
    seconds: float = 0.0
    raw_text: str = ""
    notes: Mapping[str, str] = field(default_factory=dict)
    file: str | None = None
    alternatives: Mapping[str, tuple[Joint, ...]] = field(default_factory=dict)

    @classmethod
    def of_file(cls, name: str, tree: KinematicTree) -> Prediction:
        """The joints that a file declares; declared joints have no confidence."""
        notes = {j.child: f"From {name}." for j in tree.joints}
        return cls(tree, backend=f"file {name}", notes=notes, file=name)

    def likely(self, child: str) -> tuple[Joint, ...]:
        """The joint of ``child`` and its alternatives, likeliest first."""
        joint = self.joint(child)
        return () if joint is None else (joint, *self.alternatives.get(child, ()))

    def joint(self, child: str) -> Joint | None:
        """The joint of ``child``, or None."""
        return None if self.tree is None else self.tree.joint_of.get(child)
