"""``artiworld train``: samples, training in slices, weights for use."""

from __future__ import annotations

import math
import os
import sys
from dataclasses import replace

from app.cli.output import check_output
from app.cli.printing import progress_bar
from app.cli.research_commands import TrainCommand
from model.core.errors import ConfigurationError
from model.data.procedural.generate import family_names
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
from model.training.arti4urdf.samples import HELD_OUT, make_shards, write_dataset

MOST_HELD_OUT = 200
"""Samples of validation, and of held-out categories, at most."""


def train(options: TrainCommand) -> int:
    """Make missing samples, train, and write weights.

    Raises:
        ConfigurationError: for a mistake in the options.
    """
    if options.workspace is not None:
        from app.cli.learn import learn  # opens a workspace

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
        from app.cli.train_full import train_full_model  # needs the packages of an extra

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
            options.out, options.weights, samples=options.samples, seed=options.seed, jobs=jobs,
            progress=progress,
        )  # fmt: skip
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
            data, options.samples, seed=options.seed + 1, jobs=options.jobs, families=families,
            progress=progress,
        )  # fmt: skip
        make_shards(validation, few, seed=options.seed + 900, progress=progress)
        make_shards(held_out, few, seed=options.seed + 901, families=HELD_OUT, progress=progress)
        for root in options.data:
            _, bad = write_dataset(
                root, data, held_out=options.all_categories, test_share=options.test_share,
                progress=progress,
            )  # fmt: skip
            for problem in bad:
                print(f"left out: {problem}", file=sys.stderr)
        small_trainer.train(
            config, data, options.out, validation=validation, held_out=held_out,
            seconds=options.minutes * 60, progress=progress,
        )  # fmt: skip
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
        preset, samples=options.samples, seed=options.seed, steps=options.steps or 0,
        held_out=options.all_categories, test_share=options.test_share,
    )  # fmt: skip
    if large.lora:
        config = replace(config, lora_rank=LORA_RANK, learning_rate=LORA_RATE)
    config = with_settings(config, large.settings)
    require_extras(config)
    return config
