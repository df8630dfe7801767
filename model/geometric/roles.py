"""How each part moves: by its name where that says it, else by what it looks like."""

from __future__ import annotations

from model.geometric.context import Assembly, PartContext
from model.geometric.vocabulary import Mechanism, mechanism_of


def guess_mechanisms(
    assembly: Assembly,
) -> tuple[dict[int, Mechanism], dict[int, str], dict[int, float]]:
    """Mechanism, reason and certainty (0..1) of each part but the root."""
    mechanisms: dict[int, Mechanism] = {}
    reasons: dict[int, str] = {}
    sureness: dict[int, float] = {}
    for i, shape in enumerate(assembly.scene.shapes):
        if i == assembly.root:
            continue
        said, word = mechanism_of(shape.name, assembly.scene.category)
        if said is not None:
            mechanisms[i], reasons[i], sureness[i] = said, f"named {shape.name!r}", 0.95
            continue
        context = PartContext(assembly, i)
        mechanisms[i], reasons[i], sureness[i] = by_shape(context)
        del word
    return mechanisms, reasons, sureness


def by_shape(context: PartContext) -> tuple[Mechanism, str, float]:
    return "hinge", "default", 0.3
