"""The port that every data set of articulated objects fits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from model.core.articulated_object import ArticulatedObject, Part, SegmentedObject


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """One object with its true kinematic tree, in the world frame (metres, +z up) at q = 0.

    Attributes:
        id: the object's name within its data set.
        object: parts (already merged to those that move on their own), tree, category. Links
            without geometry are helpers and don't begin with ``link_``.
        notes: human-readable remarks on changes made on reading.
    """

    id: str
    object: ArticulatedObject
    notes: tuple[str, ...] = ()

    def segmented(self, *, names: bool = True) -> SegmentedObject:
        """The predictor's input: the parts in their rest pose, without the tree.

        Args:
            names: whether part names and the category come along.
        """
        parts = self.object.parts
        if not names:
            parts = tuple(Part(p.link, p.mesh, p.cloud) for p in parts)
        return SegmentedObject(self.id, parts, self.object.category if names else None)


@runtime_checkable
class Dataset(Protocol):
    """A folder or generator of ground-truth objects."""

    @property
    def name(self) -> str:
        """Name of the data set, as on the command line."""
        ...

    def category(self, object_id: str) -> str | None:
        """The category of an object, read without its geometry; None if unknown."""
        ...

    def ids(self) -> tuple[str, ...]:
        """Names of all objects, sorted."""
        ...

    def load(self, object_id: str) -> GroundTruth:
        """Read one object.

        Raises:
            ArtiworldError: where its files are missing or broken, naming the file.
        """
        ...
