"""Training of the paper-size model with ``artiworld train``."""

from __future__ import annotations

import math
import os
from contextlib import nullcontext
from typing import Any

from app.cli.printing import progress_bar
from app.cli.research_commands import TrainCommand
from model.core.progress import no_progress
from model.data.datasets import training_ids
from model.data.procedural.generate import family_names
from model.data.registry import recognised
from model.training.arti4urdf.config import FullConfig
from model.training.arti4urdf.full_data import ObjectSet
from model.training.arti4urdf.full_trainer import LEFT_OUT, Sources, train_full
from model.training.arti4urdf.samples import training_families


def train_full_model(options: TrainCommand, config: FullConfig) -> int:
    """Train, print how far it came, and return the exit code."""
    # Of several processes only the first one prints.
    prints = os.environ.get("RANK", "0") == "0"
    bar: Any = progress_bar() if prints else nullcontext(no_progress)
    with bar as progress:
        progress(0.0, "reading weights")
        done = train_full(
            config, _sources(options, config), options.out, seconds=options.minutes * 60,
            weights=options.weights, progress=progress,
        )  # fmt: skip
    if not prints:
        return 0
    loss = "" if math.isnan(done.loss) else f", loss {done.loss:.4f}"
    print(f"step {done.step} of {done.steps}{loss}")
    if any(done.left_out.values()):
        counts = ", ".join(f"{n} {why}" for why, n in done.left_out.items())
        print(f"left out: {counts} ({options.out / LEFT_OUT})")
    if options.weights is not None:
        print(f"weights: {options.weights} (use them as qwen3:{options.weights})")
    return 0


def _sources(options: TrainCommand, config: FullConfig) -> Sources:
    """Weights to start from, training and validation objects."""
    families = family_names() if config.held_out else training_families()
    listed = []
    for dataset in map(recognised, options.data):
        ids = training_ids(dataset, held_out=config.held_out, test_share=config.test_share)
        listed += [(dataset, object_id) for object_id in ids]
    large, seed = options.full_model, config.seed
    assert large.point_encoder is not None and large.language_model is not None
    objects = ObjectSet(config.samples, seed + 1, families, tuple(listed), large.cache)
    held = ObjectSet(config.validation, seed + 900, training_families(), (), large.cache)
    local = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    cores = (os.cpu_count() or 1) // local - 1
    jobs = max(0, (options.jobs or cores + 1) - 1)  # this process itself is one
    return Sources(large.point_encoder, large.language_model, objects, held, jobs=jobs)
