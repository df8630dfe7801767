"""Our procedural objects as a data set: made on the fly from a seed, no file needed.

A folder that ``artiworld generate`` wrote is read as PartNet-Mobility, whose form it has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import affine, rotation_from_rpy
from model.data.procedural.corruption import FAULTS, corrupted
from model.data.procedural.generate import OBJ_FROM_OBJECT, family_names, make
from model.data.procedural.grammar import transformed
from model.data.protocol import GroundTruth

SEEDS = 10**9


@dataclass(frozen=True)
class ProceduralSet:
    """``n`` objects of each family; the same seed gives the same objects.

    Attributes:
        seed: random seed; ids are ``<family>_<seed>_<index>``, as ``generate`` names folders.
        n: objects a family.
        families: names of families; all of them where empty.
        fault: one of :data:`~model.data.procedural.corruption.FAULTS`, "" for clean meshes.
    """

    seed: int = 0
    n: int = 1
    families: tuple[str, ...] = ()
    name: str = "procedural"
    fault: str = ""

    def __post_init__(self) -> None:
        if self.n < 1:
            raise ConfigurationError(f"n must be 1 or more, got {self.n}")
        if not 0 <= self.seed < SEEDS:
            raise ConfigurationError(f"the seed must be 0..{SEEDS - 1}, got {self.seed}")
        unknown = sorted(set(self.families) - set(family_names()))
        if unknown:
            known = ", ".join(family_names())
            raise ConfigurationError(f"no family {unknown[0]!r}; there are {known}")
        if self.fault and self.fault not in FAULTS:
            raise ConfigurationError(f"no fault {self.fault!r}; there are {', '.join(FAULTS)}")

    def ids(self) -> tuple[str, ...]:
        """All of them, sorted by family."""
        names = sorted(self.families or family_names())
        return tuple(f"{f}_{self.seed}_{i}" for f in names for i in range(self.n))

    def category(self, object_id: str) -> str | None:
        """The family."""
        return object_id.rsplit("_", 2)[0]

    def load(self, object_id: str) -> GroundTruth:
        """Make one object, its front to -x as PartNet-Mobility's objects stand.

        Raises:
            InputFileError: where ``object_id`` isn't ``<family>_<seed>_<index>``.
        """
        try:
            family, seed, index = object_id.rsplit("_", 2)
            made = make(family, int(seed), int(index))
        except ValueError:
            raise InputFileError(
                object_id, "names no procedural object", "write <family>_<seed>_<index>"
            ) from None
        turn = affine(rotation_from_rpy((np.pi / 2, 0, -np.pi / 2)) @ OBJ_FROM_OBJECT)
        made = replace(made, object=transformed(made.object, turn))
        if self.fault:
            rng = np.random.default_rng([int(seed), int(index), 11])
            return corrupted(made, FAULTS[self.fault], rng, name=object_id)
        return GroundTruth(object_id, made.object)
