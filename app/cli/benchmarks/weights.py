"""``artiworld bench weights``: whether the shipped network reads the clouds that it is given.

Its teacher-forced decisions on new objects without names are compared with those on shuffled input:
a network that has collapsed decides the same. Releases need a loss of at least 0.10 of the joint
types for shuffled shapes and 0.03 for shuffled clouds, and more surprise for foreign wholes.
"""

from __future__ import annotations

from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from model.core.progress import Progress
from model.prediction.arti4urdf.network import load_weights
from model.training.arti4urdf.small_trainer import (
    both,
    foreign_wholes,
    probe,
    shuffled_clouds,
    shuffled_shapes,
    unseen_samples,
    without_rules,
)

OBJECTS = 64
"""With half as many, two decisions that turn over can hide what a whole cloud is worth."""


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    samples = unseen_samples(OBJECTS if options.limit is None else options.limit, progress)
    model, version = load_weights()
    changes = {
        "as it is": None,
        "shapes shuffled": shuffled_shapes,
        "without rules": without_rules,
        "without rules, clouds shuffled": both(without_rules, shuffled_clouds),
        "without rules, foreign wholes": both(without_rules, foreign_wholes),
    }
    rows = []
    for name, change in changes.items():
        found = probe(model, samples, change)
        rows.append({
            "input": name, "types": round(found.types, 3), "candidates": round(found.slots, 3),
            "parents": round(found.trees, 3), "surprise": round(found.surprise, 4),
        })  # fmt: skip
    report = {"weights": version, "objects": len(samples), "rows": rows}
    return report, lambda: print_records(f"Right decisions of {version}", rows)
