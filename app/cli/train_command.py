"""``artiworld train``: samples, training in slices, weights for use."""

from __future__ import annotations

import argparse
import math
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from model.training.arti4urdf.full_config import FullConfig
    from model.training.arti4urdf.full_loop import Sources


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add = parser.add_argument
    add("--preset", default="nano", metavar="NAME",
        help="configuration: nano (default), or of the paper-size model qwen3-0.6b, qwen3-1.7b, "
             "qwen3-4b, paper (Qwen3-8B), qwen3 (any size); confidence fits how sure the "
             "predictors may be")  # fmt: skip
    add(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the run; run again to go on",
    )
    add("--samples", type=int, default=8000, metavar="N",
        help="procedural objects to train on, made where missing (default: 8000)")  # fmt: skip
    add("--data", type=Path, action="append", default=[], metavar="DIR",
        help="folder of PartNet-Mobility or PhysXNet to train on as well (repeatable)")  # fmt: skip
    add("--all-categories", action="store_true",
        help="train on the paper's five held-out categories too")  # fmt: skip
    add("--test-share", type=float, default=0.0, metavar="S",
        help="leave out what evaluate --split test:S scores of each --data")  # fmt: skip
    add("--steps", type=int, default=None, metavar="N", help="length of the schedule")
    add("--seed", type=int, default=0, help="of weights, samples and their order (default: 0)")
    add("--minutes", type=float, default=math.inf, metavar="M",
        help="stop after this long and keep the state (default: no limit)")  # fmt: skip
    add(
        "--jobs",
        type=int,
        default=0,
        metavar="N",
        help="processes that make samples (default: all cores)",
    )
    add("--weights", type=Path, default=None, metavar="DIR",
        help="write the weights here at the end, ready for use")  # fmt: skip
    add(
        "--version-name", default="", metavar="TEXT", help="recorded with the small model's weights"
    )
    full = parser.add_argument_group("paper-size model")
    add = full.add_argument
    add("--language-model", type=Path, metavar="DIR", help="folder of Qwen3 as published")
    add("--point-encoder", type=Path, metavar="FILE", help="ULIP-2 checkpoint with Point-BERT")
    add("--lora", action="store_true",
        help="train updates of rank 16 at a rate of 1e-4 instead of all weights")  # fmt: skip
    add("--cache", type=Path, metavar="DIR",
        help="keep objects here once they are made or read (default: anew each time)")  # fmt: skip
    add("--set", dest="settings", action="append", default=[], metavar="NAME=VALUE",
        help="change a setting, as in --set epochs=5 (repeatable)")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Make what samples are missing, train, write weights.

    Raises:
        ConfigurationError: for a mistake in the options.
    """
    from app.cli.headless import check_output
    from model.core.errors import ConfigurationError
    from model.training.arti4urdf.config import CONFIDENCE
    from model.training.arti4urdf.full_config import full_presets

    if args.samples < 1 or args.minutes <= 0 or args.jobs < 0:
        raise ConfigurationError("--samples, --minutes and --jobs must be positive")
    if not 0 <= args.test_share < 1:
        raise ConfigurationError(f"--test-share is a share of 0..1, got {args.test_share}")
    if args.steps is not None and args.steps < 1:
        raise ConfigurationError(f"--steps must be 1 or more, got {args.steps}")
    check_output(args.out)
    full = full_presets().get(args.preset)
    if full is not None:
        return _train_full(args, full)
    if args.language_model or args.point_encoder or args.lora or args.cache or args.settings:
        raise ConfigurationError(
            "--language-model, --point-encoder, --lora, --cache and --set belong to the paper-size "
            f"model; with --preset {args.preset} leave them out, or choose one of "
            f"{', '.join(full_presets())}"
        )
    if args.preset == CONFIDENCE:
        return _fit_confidence(args)
    return _train_small(args)


def _fit_confidence(args: argparse.Namespace) -> int:
    from model.core.errors import ConfigurationError
    from model.evaluation.table import progress_bar
    from model.training.arti4urdf.confidence import PREDICTORS, fit_confidence
    from model.training.arti4urdf.config import CONFIDENCE

    if args.data or args.steps is not None or not math.isinf(args.minutes):
        raise ConfigurationError(
            f"--preset {CONFIDENCE} fits to made objects alone; leave out --data, --steps and "
            "--minutes"
        )
    with progress_bar() as report:
        found = fit_confidence(
            args.out,
            args.weights,
            samples=args.samples,
            seed=args.seed,
            jobs=args.jobs or os.cpu_count() or 1,
            progress=report,
        )
    for name in PREDICTORS:
        told = found["record"][name]
        print(
            f"{name}: {told['joints']} joints; of {told['tested']} left out of a trial fit "
            f"{told['right']:.0%} right, "
            f"calibration error {told['calibration_error']:.3f}, Brier {told['brier']:.3f}"
        )
    if args.weights is not None:
        print(f"confidence: {args.weights}")
    return 0


def _train_small(args: argparse.Namespace) -> int:
    from dataclasses import replace

    from model.data.procedural.generate import family_names
    from model.evaluation.table import progress_bar
    from model.training.arti4urdf.config import preset
    from model.training.arti4urdf.loop import export_weights, train
    from model.training.arti4urdf.samples import HELD_OUT, make_shards, write_dataset

    config = replace(preset(args.preset), seed=args.seed)
    if args.steps is not None:
        config = replace(config, steps=args.steps)
    families = family_names() if args.all_categories else None
    data, held = args.out / "samples", args.out / "validation"
    with progress_bar() as report:
        make_shards(
            data,
            args.samples,
            seed=args.seed + 1,
            jobs=args.jobs,
            families=families,
            progress=report,
        )
        make_shards(held, min(200, args.samples), seed=args.seed + 900, progress=report)
        held_out = args.out / "held_out"
        make_shards(
            held_out,
            min(200, args.samples),
            seed=args.seed + 901,
            families=HELD_OUT,
            progress=report,
        )
        for root in args.data:
            _, bad = write_dataset(
                root,
                data,
                held_out=args.all_categories,
                test_share=args.test_share,
                progress=report,
            )
            for problem in bad:
                print(f"left out: {problem}", file=sys.stderr)
        train(
            config,
            data,
            args.out,
            validation=held,
            held_out=held_out,
            seconds=args.minutes * 60,
            progress=report,
        )
    if args.weights is not None:
        export_weights(args.out, args.weights, version=args.version_name or args.preset)
        print(f"weights: {args.weights}")
    return 0


def _train_full(args: argparse.Namespace, preset: FullConfig) -> int:
    from model.core.errors import ConfigurationError
    from model.core.progress import no_progress
    from model.evaluation.table import progress_bar
    from model.training.arti4urdf.full_config import require_extras

    if args.language_model is None or args.point_encoder is None:
        raise ConfigurationError(
            f"--preset {args.preset} needs --language-model, a folder of Qwen3, and "
            "--point-encoder, a checkpoint of ULIP-2"
        )
    config = _full_config(args, preset)
    require_extras(config)
    from model.training.arti4urdf.full_loop import LEFT_OUT, train_full

    # With several processes the first one speaks.
    speaks = os.environ.get("RANK", "0") == "0"
    bar: Any = progress_bar() if speaks else nullcontext(no_progress)
    with bar as report:
        report(0.0, "reading weights")
        done = train_full(
            config,
            _sources(args, config),
            args.out,
            seconds=args.minutes * 60,
            weights=args.weights,
            progress=report,
        )
    if not speaks:
        return 0
    loss = "" if math.isnan(done.loss) else f", loss {done.loss:.4f}"
    print(f"step {done.step} of {done.steps}{loss}")
    if any(done.left_out.values()):
        counts = ", ".join(f"{n} {why}" for why, n in done.left_out.items())
        print(f"left out: {counts} ({args.out / LEFT_OUT})")
    if args.weights is not None:
        print(f"weights: {args.weights} (use them as qwen3:{args.weights})")
    return 0


def _full_config(args: argparse.Namespace, preset: FullConfig) -> FullConfig:
    """The preset with the options, then with --set."""
    from dataclasses import replace

    from model.training.arti4urdf.full_config import LORA_RANK, LORA_RATE, with_settings

    config = replace(
        preset,
        samples=args.samples,
        seed=args.seed,
        steps=args.steps or 0,
        held_out=args.all_categories,
        test_share=args.test_share,
    )
    if args.lora:
        config = replace(config, lora_rank=LORA_RANK, learning_rate=LORA_RATE)
    return with_settings(config, args.settings)


def _sources(args: argparse.Namespace, config: FullConfig) -> Sources:
    from model.data.procedural.generate import family_names
    from model.data.registry import recognised
    from model.data.splits import training_ids
    from model.training.arti4urdf.full_data import ObjectSet
    from model.training.arti4urdf.full_loop import Sources
    from model.training.arti4urdf.samples import training_families

    families = family_names() if config.held_out else training_families()
    listed = []
    for dataset in map(recognised, args.data):
        ids = training_ids(dataset, held_out=config.held_out, test_share=config.test_share)
        listed += [(dataset, object_id) for object_id in ids]
    objects = ObjectSet(config.samples, config.seed + 1, families, tuple(listed), args.cache)
    held = ObjectSet(config.validation, config.seed + 900, training_families(), (), args.cache)
    local = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    cores = (os.cpu_count() or 1) // local - 1
    return Sources(
        args.point_encoder,
        args.language_model,
        objects,
        held,
        # One is this process itself.
        jobs=max(0, (args.jobs or cores + 1) - 1),
    )
