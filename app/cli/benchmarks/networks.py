"""``artiworld bench networks``: time and memory of the paper-size networks on this machine.

The weights are random and of the published sizes: nothing is downloaded, and time and memory are
those of the real ones. They take the same path as real weights: the folders are written, read,
trained on procedural objects, written again and used for prediction.

Each figure has a baseline of the same run: float32 without checkpointing for training, token by
token for writing with forced spans, encoding anew for a click on the encoded cloud.
"""

from __future__ import annotations

import gc
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file

from app.cli.bench_commands import NetworksBench
from app.cli.benchmarks.shapes import chest
from app.cli.output import Result, print_records
from model.core.asset import Asset
from model.core.errors import ConfigurationError
from model.core.geometry import merged
from model.core.packages import require
from model.core.progress import Progress, no_progress
from model.geometry.sampling import sample_surface
from model.prediction.arti4urdf.checkpoints import write_random_qwen3, write_random_ulip2
from model.prediction.arti4urdf.full_model import Example, FullModel, make_full_model
from model.prediction.arti4urdf.full_predictor import load_full_predictor, make_example
from model.prediction.arti4urdf.language_model import QWEN3, Decoder, DecoderConfig
from model.prediction.arti4urdf.point_bert import ULIP2, PointBertConfig
from model.segmentation.adapters.point_sam import PointSamSegmenter
from model.segmentation.adapters.point_sam_network import PointSamConfig, PointSamNetwork
from model.segmentation.prompts import Click, Prompts
from model.training.arti4urdf.config import LORA_RANK, FullConfig
from model.training.arti4urdf.full_data import Draws, ObjectSet
from model.training.arti4urdf.full_trainer import load_model
from model.training.arti4urdf.samples import training_families

TOO_LARGE = "does not fit"
_GIGABYTE = 1e9


@dataclass(frozen=True)
class NetworksConfig:
    """Settings of the benchmark.

    Attributes:
        sizes: name → language model; None takes all of them on a GPU, else the smallest.
        train: also train; None does on a GPU only, as a step takes minutes on a CPU.
        encoder: configuration of the point encoder.
        point_sam: configuration of Point-SAM; None for the published one.
        points: size of Point-SAM's cloud.
        steps: training steps that are timed, after one that isn't.
        clicks: clicks that are timed, after one that isn't.
        parts: parts of the object that is predicted.
        training: how objects are drawn for training.
    """

    sizes: dict[str, DecoderConfig] | None = None
    train: bool | None = None
    encoder: PointBertConfig = ULIP2
    point_sam: PointSamConfig | None = None
    points: int = 100_000
    steps: int = 8
    clicks: int = 8
    parts: int = 5
    training: FullConfig = field(default_factory=FullConfig)


def networks_bench(options: NetworksBench, progress: Progress) -> Result:
    """Measure with the options of the command.

    Raises:
        ConfigurationError: for an unknown size.
    """
    for name in options.sizes:
        if name not in QWEN3:
            raise ConfigurationError(f"no size {name!r}; there are {', '.join(QWEN3)}")
    sizes = {name: QWEN3[name] for name in options.sizes} if options.sizes else None
    report = measure(NetworksConfig(sizes=sizes, train=options.train or None), progress)

    def show() -> None:
        for title, rows in tables(report):
            print_records(title, rows)

    return Result(report, show)


def measure(config: NetworksConfig, progress: Progress = no_progress) -> dict[str, Any]:
    """Seconds, tokens and gigabytes of each network, and the device."""
    require("transformers.utils.logging", "network", "this benchmark").disable_progress_bar()
    gpu = torch.cuda.is_available()
    device = "cuda" if gpu else "cpu"
    sizes = config.sizes
    if sizes is None:
        sizes = QWEN3 if gpu else dict(list(QWEN3.items())[:1])
    train = gpu if config.train is None else config.train
    name = torch.cuda.get_device_name() if gpu else f"CPU, {torch.get_num_threads()} threads"
    report: dict[str, Any] = {"device": name, "torch": torch.__version__}
    progress(0.0, "generating objects")
    examples = _examples(config)
    rows: list[dict[str, Any]] = []
    share = 0.85 / len(sizes)
    for k, (size_name, size) in enumerate(sizes.items()):

        def within(fraction: float, message: str, begin: float = 0.05 + k * share) -> None:
            progress(begin + fraction * share, message)

        with tempfile.TemporaryDirectory(prefix="artiworld-bench-") as folder:
            rows.append(
                _language_model(
                    size_name, size, config, examples, Path(folder), device, train, within
                )
            )
    report["Arti4URDF"] = rows
    progress(0.9, "Point-SAM")
    report["Point-SAM"] = _point_sam(config, device)
    return report


def _examples(config: NetworksConfig) -> list[Example]:
    """Objects to train on, drawn as training draws them, whatever their length.

    Raises:
        ConfigurationError: where none can be drawn, with the reason.
    """
    objects = ObjectSet(config.steps + 1, 1, training_families())
    every = replace(config.training, longest=10**9)
    draws = Draws(objects, every, _Uncounted(), len(objects))  # type: ignore[arg-type]
    drawn = [draws[k] for k in range(len(objects))]
    for d in drawn:
        if d.example is None:
            name, why = d.left_out[-1]
            raise ConfigurationError(f"no object can be drawn; the last was {name}: {why}")
    return [d.example for d in drawn if d.example is not None]


class _Uncounted:
    """Replaces the tokenizer, which is made from these texts afterwards."""

    def encode(self, text: str, **_: Any) -> Any:
        """Return an empty encoding."""
        return type("Encoding", (), {"ids": ()})()


def _language_model(
    size_name: str,
    size: DecoderConfig,
    config: NetworksConfig,
    examples: list[Example],
    folder: Path,
    device: str,
    train: bool,
    progress: Progress,
) -> dict[str, Any]:
    progress(0.0, f"Qwen3-{size_name}: writing random weights")
    texts = [text for e in examples for text in (e.prompt, e.answer)]
    qwen3 = write_random_qwen3(folder / "qwen3", size, texts, device=device)
    ulip2 = write_random_ulip2(folder / "ulip2.pt", config.encoder)
    row: dict[str, Any] = {"model": f"Qwen3-{size_name.upper()}"}
    if train:
        variants = {
            "all weights": config.training,
            "LoRA": replace(config.training, lora_rank=LORA_RANK),
            "float32": replace(config.training, bfloat16=False, checkpointing=False),
        }
        for k, (variant, training) in enumerate(variants.items()):
            progress(0.1 + 0.2 * k, f"Qwen3-{size_name}: training, {variant}")
            if not training.lora_rank and _too_large(size):
                row[f"training, {variant}"] = TOO_LARGE  # loading it before it fails takes minutes
                continue
            row[f"training, {variant}"] = _unless_too_large(
                lambda training=training: _training(training, ulip2, qwen3, examples, device)
            )
    progress(0.7, f"Qwen3-{size_name}: predicting")
    row["predicting"] = _unless_too_large(
        lambda: _predicting(config, ulip2, qwen3, folder / "model", device)
    )
    return row


def _too_large(size: DecoderConfig) -> bool:
    """True if weights, gradients and Adam's two moments in float32 exceed the GPU's memory."""
    if not torch.cuda.is_available():
        return False
    with torch.device("meta"):
        weights = sum(p.numel() for p in Decoder(size).parameters())
    return 16 * weights > torch.cuda.mem_get_info()[1]


def _unless_too_large(work: Callable[[], dict[str, Any]]) -> dict[str, Any] | str:
    try:
        return work()
    except torch.OutOfMemoryError:
        return TOO_LARGE
    finally:
        gc.collect()
        if torch.cuda.is_available():
            torch.cuda.empty_cache()


def _training(
    config: FullConfig, ulip2: Path, qwen3: Path, examples: list[Example], device: str
) -> dict[str, Any]:
    """Train with one object per step, as on each of the paper's GPUs."""
    start = time.perf_counter()
    model = load_model(config, ulip2, qwen3).to(device).train()
    if config.checkpointing:
        model.use_gradient_checkpointing()
    optimizer = torch.optim.Adam(model.trained_parameters(), lr=config.learning_rate)
    loading = time.perf_counter() - start
    times, tokens, losses = [], 0, []
    with _peak_memory() as peak:
        for k, example in enumerate(examples):
            start = time.perf_counter()
            optimizer.zero_grad(set_to_none=True)
            with torch.autocast(device, torch.bfloat16, enabled=config.bfloat16):
                loss = model([example])
            loss.backward()
            torch.nn.utils.clip_grad_norm_(list(model.trained_parameters()), 1.0)
            optimizer.step()
            losses.append(float(loss.detach()))  # waits for the device
            if k:
                times.append(time.perf_counter() - start)
                tokens += _length(model, example)
    return {
        "s an object": _rounded(statistics.mean(times)),
        "tokens/s": round(tokens / sum(times)),
        "tokens an object": round(tokens / len(times)),
        "peak GB": peak(),
        "loading s": _rounded(loading),
        "loss": [_rounded(losses[0]), _rounded(losses[-1])],
    }


def _length(model: FullModel, example: Example) -> int:
    encode = model.tokenizer.encode
    return sum(
        len(encode(text, add_special_tokens=False).ids) for text in (example.prompt, example.answer)
    )


def _predicting(
    config: NetworksConfig, ulip2: Path, qwen3: Path, folder: Path, device: str
) -> dict[str, Any]:
    """Predict a chest of drawers; the baseline writes as many tokens one by one."""
    dtype = torch.bfloat16 if device == "cuda" else torch.float32
    model = make_full_model(ulip2, qwen3, dtype=dtype)
    sizes = {n: getattr(config.training, n) for n in ("points", "groups", "neighbours")}
    model.encoder.config = replace(config.encoder, **sizes)
    model.save(folder)
    del model
    gc.collect()
    start = time.perf_counter()
    predictor = load_full_predictor(folder)
    loading = time.perf_counter() - start
    segmented = chest(config.parts - 1)
    reader, engine = predictor._reader, predictor._engine
    example = make_example(segmented, reader.encoder.config.points)
    with _peak_memory() as peak:
        predictor.predict(segmented)  # compiles kernels
        prediction = predictor.predict(segmented)
    _, reading = _timed(lambda: reader.prompt_embeddings(example).sum().item())
    prompt = reader.prompt_embeddings(example)
    tokens = len(reader.tokenizer.encode(prediction.raw_text, add_special_tokens=False).ids)
    # Random weights seldom end an answer; a few hundred tokens give the time of each.
    some = min(tokens, 200)
    text, writing = _timed(lambda: engine.generate(prompt, max_tokens=some))
    count = max(1, len(reader.tokenizer.encode(text.text, add_special_tokens=False).ids))
    plain = writing / (count if text.complete else some) * tokens
    return {
        "s an object": _rounded(prediction.seconds),
        "of which clouds s": _rounded(reading),
        "prompt tokens": len(prompt),
        "answer tokens": tokens,
        "token by token s": _rounded(reading + plain),
        "times as fast": _rounded((reading + plain) / prediction.seconds),
        "peak GB": peak(),
        "loading s": _rounded(loading),
    }


def _point_sam(config: NetworksConfig, device: str) -> dict[str, Any]:
    """Encode a cloud once and click; the baseline encodes anew at each click."""
    asset = _cloud(config.points)
    places = asset.element_centers
    chosen = np.random.default_rng(0).choice(len(places), config.clicks + 1, replace=False)
    clicks = tuple(
        Click((float(x), float(y), float(z)), 1, positive=k % 3 != 2)
        for k, (x, y, z) in enumerate(places[chosen])
    )
    with tempfile.TemporaryDirectory(prefix="artiworld-bench-") as folder:
        path = Path(folder) / "model.safetensors"
        torch.manual_seed(0)
        save_file(PointSamNetwork(config.point_sam or PointSamConfig()).state_dict(), path)
        segmenter = PointSamSegmenter(path)
        _, first = _timed(lambda: segmenter.encode(asset))
    with _peak_memory() as peak:
        session, encoding = _timed(lambda: segmenter.encode(asset))
        times = [
            _timed(lambda k=k: session.segment(Prompts(clicks[: k + 1])))[1]
            for k in range(len(clicks))
        ][1:]
    click = statistics.median(times)
    return {
        "points": config.points,
        "loading and encoding s": _rounded(first),
        "encoding s": _rounded(encoding),
        "click ms": _rounded(1e3 * click),
        "encoding anew at each click ms": _rounded(1e3 * (encoding + click)),
        "times as fast": _rounded((encoding + click) / click),
        "peak GB": peak(),
    }


def _cloud(points: int) -> Asset:
    mesh = merged([part.mesh for part in chest(6).parts if part.mesh is not None])
    cloud, _ = sample_surface(mesh, points, np.random.default_rng(0))
    return Asset("chest", cloud=cloud)


@contextmanager
def _peak_memory() -> Iterator[Callable[[], float | None]]:
    """The GPU's peak memory within the block, in GB; None on a CPU."""
    gpu = torch.cuda.is_available()
    if gpu:
        torch.cuda.reset_peak_memory_stats()
    yield lambda: _rounded(torch.cuda.max_memory_allocated() / _GIGABYTE) if gpu else None


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    answer = work()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return answer, time.perf_counter() - start


def _rounded(value: float) -> float:
    """Round to three significant digits."""
    if not value or not math.isfinite(value):
        return value
    return round(value, max(0, 2 - math.floor(math.log10(abs(value)))))


def tables(report: dict[str, Any]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Title and rows of each table."""
    where = f"{report['device']}, torch {report['torch']}, random weights"
    out = []
    kinds = dict.fromkeys(k for row in report["Arti4URDF"] for k in row if k != "model")
    for kind in kinds:
        found = {row["model"]: row[kind] for row in report["Arti4URDF"]}
        names = dict.fromkeys(n for f in found.values() if not isinstance(f, str) for n in f)
        names = names or {"": None}
        rows = []
        for model, figures in found.items():
            cells = {next(iter(names)): figures} if isinstance(figures, str) else figures
            rows.append({"model": model, **{n: _shown(cells.get(n, "")) for n in names}})
        out.append((f"Arti4URDF, {kind} ({where})", rows))
    row = {name: _shown(value) for name, value in report["Point-SAM"].items()}
    return [*out, (f"Point-SAM, ViT-L ({where})", [row])]


def _shown(value: Any) -> Any:
    if value is None:
        return "–"
    return " → ".join(map(str, value)) if isinstance(value, list) else value
