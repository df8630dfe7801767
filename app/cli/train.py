"""``artiworld train``: samples, training in slices, weights for use; the paper-size model; and with
``--workspace`` predictions that know what was accepted.
"""

from __future__ import annotations

import math
import os
import sys
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.cli import output
from app.cli.output import check_output, progress_bar
from app.cli.research_commands import TrainCommand
from app.server.ending import WorkspaceLease
from app.server.learning import learn_from
from model.core.errors import ConfigurationError
from model.core.progress import no_progress
from model.data.datasets import training_ids
from model.data.procedural.generate import family_names
from model.data.registry import recognised
from model.prediction.experience import FOLDER, record_of
from model.training.arti4urdf import small_trainer
from model.training.arti4urdf.confidence import PREDICTORS, fit_confidence
from model.training.arti4urdf.config import (
    CONFIDENCE,
    LORA_RANK,
    LORA_RATE,
    FullConfig,
    full_presets,
    preset,
    require_extras,
    with_settings,
)
from model.training.arti4urdf.full_data import ObjectSet
from model.training.arti4urdf.full_trainer import LEFT_OUT, Sources, train_full
from model.training.arti4urdf.samples import HELD_OUT, make_shards, training_families, write_dataset
from model.training.experience import use
from sessions.command_log import check_workspace


def learn(options: TrainCommand, workspace: Path) -> int:
    """Learn from a workspace, or go back to an earlier version; returns the exit code.

    Raises:
        ConfigurationError: for an unknown version or object, or too few accepted objects.
    """
    check_workspace(workspace, options.database)
    if options.use is not None:
        use(workspace, options.use)
        record = record_of(workspace / FOLDER / str(options.use)) if options.use else {}
        with output.session(options.json) as show:
            text = f"predictions use version {options.use}" if options.use else "nothing is used"
            show.result(record, lambda: print(text))
        return 0
    with closing(WorkspaceLease(workspace)), output.session(options.json) as show:
        learned = learn_from(
            workspace, options.database, options.without, options.jobs or 2, show.progress
        )
    show.result(learned, lambda: _print(learned))
    return 0


def _print(learned: dict[str, Any]) -> None:
    print(f"version {learned['version']}: {len(learned['assets'])} accepted objects")
    print("each predicted, against what was accepted:")
    for label, side in (("without", learned["before"]), ("with the others", learned["after"])):
        print(f"  {label:<16}{_figures(side)}")
    if learned["taken"]:
        print("it is better: predictions in this workspace use it from now on")
    else:
        print("it is no better: predictions stay as they are")


def _figures(side: dict[str, Any]) -> str:
    return (
        f"{side['usable']} of {side['joints']} joints and {side['objects']} objects usable, "
        f"calibration error {side['calibration_error']:.3f}"
    )


def train_full_model(options: TrainCommand, config: FullConfig) -> int:
    """Train, print how far it came, and return the exit code."""
    # Of several processes only the first one prints.
    prints = os.environ.get("RANK", "0") == "0"
    bar: Any = progress_bar() if prints else nullcontext(no_progress)
    with bar as progress:
        progress(0.0, "reading weights")
        done = train_full(
            config,
            _sources(options, config),
            options.out,
            seconds=options.minutes * 60,
            weights=options.weights,
            progress=progress,
        )
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


MOST_HELD_OUT = 200
"""Samples of validation, and of held-out categories, at most."""


def train(options: TrainCommand) -> int:
    """Make missing samples, train, and write weights.

    Raises:
        ConfigurationError: for a mistake in the options.
    """
    if options.workspace is not None:
        return learn(options, options.workspace)
    if options.without or options.use is not None or options.database or options.json:
        raise ConfigurationError("--without, --use, --database and --json belong to --workspace")
    if options.samples < 1 or options.minutes <= 0 or options.jobs < 0:
        raise ConfigurationError("--samples, --minutes and --jobs must be positive")
    if not 0 <= options.test_share < 1:
        raise ConfigurationError(f"--test-share is a share of 0..1, got {options.test_share}")
    if options.steps is not None and options.steps < 1:
        raise ConfigurationError(f"--steps must be 1 or more, got {options.steps}")
    check_output(options.out)
    full, large = full_presets().get(options.preset), options.full_model
    if full is not None:
        config = _full_config(options, full)

        return train_full_model(options, config)
    if large.language_model or large.point_encoder or large.lora or large.cache or large.settings:
        raise ConfigurationError(
            "--language-model, --point-encoder, --lora, --cache and --set belong to the paper-size "
            f"model; with --preset {options.preset} leave them out, or choose one of "
            f"{', '.join(full_presets())}"
        )
    if options.preset == CONFIDENCE:
        return _fit_confidence(options)
    return _train_small(options)


def _fit_confidence(options: TrainCommand) -> int:
    if options.data or options.steps is not None or not math.isinf(options.minutes):
        raise ConfigurationError(
            f"--preset {CONFIDENCE} fits to procedural objects alone; leave out --data, --steps "
            "and --minutes"
        )
    with progress_bar() as progress:
        jobs = options.jobs or os.cpu_count() or 1
        fitted = fit_confidence(
            options.out,
            options.weights,
            samples=options.samples,
            seed=options.seed,
            jobs=jobs,
            progress=progress,
        )
    for name in PREDICTORS:
        found = fitted["record"][name]
        print(
            f"{name}: {found['joints']} joints; of {found['tested']} left out of a trial fit "
            f"{found['right']:.0%} correct, "
            f"calibration error {found['calibration_error']:.3f}, Brier {found['brier']:.3f}"
        )
    if options.weights is not None:
        print(f"confidence: {options.weights}")
    return 0


def _train_small(options: TrainCommand) -> int:
    config = replace(preset(options.preset), seed=options.seed)
    if options.steps is not None:
        config = replace(config, steps=options.steps)
    families = family_names() if options.all_categories else None
    data, validation = options.out / "samples", options.out / "validation"
    held_out = options.out / "held_out"
    few = min(MOST_HELD_OUT, options.samples)
    with progress_bar() as progress:
        make_shards(
            data,
            options.samples,
            seed=options.seed + 1,
            jobs=options.jobs,
            families=families,
            progress=progress,
        )
        make_shards(validation, few, seed=options.seed + 900, progress=progress)
        make_shards(held_out, few, seed=options.seed + 901, families=HELD_OUT, progress=progress)
        for root in options.data:
            _, bad = write_dataset(
                root,
                data,
                held_out=options.all_categories,
                test_share=options.test_share,
                progress=progress,
            )
            for problem in bad:
                print(f"left out: {problem}", file=sys.stderr)
        small_trainer.train(
            config,
            data,
            options.out,
            validation=validation,
            held_out=held_out,
            seconds=options.minutes * 60,
            progress=progress,
        )
    if options.weights is not None:
        version = options.version_name or options.preset
        small_trainer.export_weights(options.out, options.weights, version=version)
        print(f"weights: {options.weights}")
    return 0


def _full_config(options: TrainCommand, preset: FullConfig) -> FullConfig:
    """The preset with the options, then with --set.

    Raises:
        ConfigurationError: where weights or packages to start from are missing.
    """
    large = options.full_model
    if large.language_model is None or large.point_encoder is None:
        raise ConfigurationError(
            f"--preset {options.preset} needs --language-model, a folder of Qwen3, and "
            "--point-encoder, a checkpoint of ULIP-2"
        )
    config = replace(
        preset,
        samples=options.samples,
        seed=options.seed,
        steps=options.steps or 0,
        held_out=options.all_categories,
        test_share=options.test_share,
    )
    if large.lora:
        config = replace(config, lora_rank=LORA_RANK, learning_rate=LORA_RATE)
    config = with_settings(config, large.settings)
    require_extras(config)
    return config
