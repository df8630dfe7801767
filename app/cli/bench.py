"""What ``artiworld bench`` does: figures that are measured now, on this machine."""

from __future__ import annotations

from collections.abc import Callable

from app.cli import printing
from app.cli.commands import BenchCommand
from model.core.progress import Progress
from model.training.arti4urdf.full_config import LORA_RANK, FullConfig, require_extras

Benchmark = Callable[[BenchCommand, Progress], printing.Result]


def bench(options: BenchCommand) -> int:
    """Measure, and print the figures."""
    benchmark = _benchmark(options.what)
    with printing.session(options.json) as show:
        report, table = benchmark(options, show.progress)
    show.result(report, table)
    return 0


def _benchmark(name: str) -> Benchmark:
    """Import a benchmark; each needs its own heavy packages (viser, torch, an extra)."""
    if name == "ui":
        from app.cli.benchmarks import ui as module
    elif name == "scene":
        from app.cli.benchmarks import scene as module
    elif name == "segment":
        from app.cli.benchmarks import segment as module
    elif name == "predict":
        from app.cli.benchmarks import predict as module
    else:
        require_extras(FullConfig(lora_rank=LORA_RANK))
        from app.cli.benchmarks import networks as module
    return module.bench
