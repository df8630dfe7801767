"""``artiworld train``: samples, training in slices, weights for use; the paper-size model; and with
``--workspace`` predictions that know what was accepted.
"""

from __future__ import annotations

import math
import os
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.cli.output import Result, check_output
from app.cli.research_commands import GenerateCommand, TrainCommand
from app.server.ending import WorkspaceLease
from app.server.learning import learn_from
from model.core.errors import ConfigurationError
from model.core.progress import Progress, no_progress
from model.data.procedural.generate import GenerateSettings, family_names, generate
from model.data.registry import recognised, training_ids
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


def generate_objects(options: GenerateCommand, progress: Progress) -> Result:
    """Write objects with ground truth."""
    check_output(options.out)
    settings = GenerateSettings(options.out, options.family, options.n, options.seed)
    folders = generate(settings, progress)
    report = {"folders": [str(f) for f in folders]}
    return Result(report, lambda: print(f"{len(folders)} objects in {options.out}"))


def learn(options: TrainCommand, workspace: Path, progress: Progress) -> Result:
    """Learn from a workspace, or go back to an earlier version.

    Raises:
        ConfigurationError: for an unknown version or object, or too few accepted objects.
    """
    check_workspace(workspace, options.database)
    if options.use is not None:
        use(workspace, options.use)
        record = record_of(workspace / FOLDER / str(options.use)) if options.use else {}
        text = f"predictions use version {options.use}" if options.use else "nothing is used"
        return Result(record, lambda: print(text))
    with closing(WorkspaceLease(workspace)):
        jobs = options.jobs or 2
        learned = learn_from(workspace, options.database, options.without, jobs, progress)
    return Result(learned, lambda: _print(learned))


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


def train_full_model(options: TrainCommand, config: FullConfig, progress: Progress) -> Result:
    """Train the paper-size model; of several processes only the first one prints."""
    prints = os.environ.get("RANK", "0") == "0"
    if not prints:
        progress = no_progress
    progress(0.0, "reading weights")
    done = train_full(
        config,
        _sources(options, config),
        options.out,
        seconds=options.minutes * 60,
        weights=options.weights,
        progress=progress,
    )
    loss = "" if math.isnan(done.loss) else f", loss {done.loss:.4f}"
    lines = [f"step {done.step} of {done.steps}{loss}"]
    if any(done.left_out.values()):
        counts = ", ".join(f"{n} {why}" for why, n in done.left_out.items())
        lines.append(f"left out: {counts} ({options.out / LEFT_OUT})")
    if options.weights is not None:
        lines.append(f"weights: {options.weights} (use them as qwen3:{options.weights})")
    return _lines(lines if prints else [])


def _lines(lines: list[str]) -> Result:
    """A result that is only for people."""
    return Result(lines, lambda: [print(line) for line in lines])


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


def train(options: TrainCommand, progress: Progress) -> Result:
    """Make missing samples, train, and write weights.

    Raises:
        ConfigurationError: for a mistake in the options.
    """
    if options.workspace is not None:
        return learn(options, options.workspace, progress)
    if options.without or options.use is not None or options.database or options.json:
        raise ConfigurationError("--without, --use, --database and --json belong to --workspace")
    if not 0 <= options.test_share < 1:
        raise ConfigurationError(f"--test-share is a share of 0..1, got {options.test_share}")
    check_output(options.out)
    full, large = full_presets().get(options.preset), options.full_model
    if full is not None:
        return train_full_model(options, _full_config(options, full), progress)
    if large.language_model or large.point_encoder or large.lora or large.cache or large.settings:
        raise ConfigurationError(
            "--language-model, --point-encoder, --lora, --cache and --set belong to the paper-size "
            f"model; with --preset {options.preset} leave them out, or choose one of "
            f"{', '.join(full_presets())}"
        )
    if options.preset == CONFIDENCE:
        return _fit_confidence(options, progress)
    return _train_small(options, progress)


def _fit_confidence(options: TrainCommand, progress: Progress) -> Result:
    if options.data or options.steps is not None or not math.isinf(options.minutes):
        raise ConfigurationError(
            f"--preset {CONFIDENCE} fits to procedural objects alone; leave out --data, --steps "
            "and --minutes"
        )
    fitted = fit_confidence(
        options.out,
        options.weights,
        samples=options.samples,
        seed=options.seed,
        jobs=options.jobs or os.cpu_count() or 1,
        progress=progress,
    )
    found = {name: fitted["record"][name] for name in PREDICTORS}
    lines = [
        f"{name}: {f['joints']} joints; of {f['tested']} left out of a trial fit "
        f"{f['right']:.0%} correct, "
        f"calibration error {f['calibration_error']:.3f}, Brier {f['brier']:.3f}"
        for name, f in found.items()
    ]
    if options.weights is not None:
        lines.append(f"confidence: {options.weights}")
    return _lines(lines)


def _train_small(options: TrainCommand, progress: Progress) -> Result:
    config = replace(preset(options.preset), seed=options.seed)
    if options.steps is not None:
        config = replace(config, steps=options.steps)
    families = family_names() if options.all_categories else None
    data, validation = options.out / "samples", options.out / "validation"
    held_out = options.out / "held_out"
    few = min(MOST_HELD_OUT, options.samples)
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
    if options.weights is None:
        return _lines([])
    version = options.version_name or options.preset
    small_trainer.export_weights(options.out, options.weights, version=version)
    return _lines([f"weights: {options.weights}"])


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
