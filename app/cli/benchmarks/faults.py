"""``artiworld bench faults``: damaged files of every format, each read in a process with limits.

Good are files that are read, and files that are refused with a message of ours. Bad are crashes,
endless readings, blow-ups of memory, and exceptions that no user can understand ("our fault").
"""

from __future__ import annotations

import random
import shutil
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from app.cli.benchmarks.clients import click_beside
from app.cli.benchmarks.fault_samples import FaultSample, damaged, fault_samples
from app.cli.benchmarks.kills import kill_servers
from app.cli.printing import Result, console, print_records
from app.cli.research_commands import BenchCommand
from app.server.job import JobFailed, OutOfTimeError, WorkerDied
from app.server.jobs import WorkerProcess
from app.server.uploads import keep_upload
from model.core.errors import ArtiworldError
from model.core.memory import limit_process
from model.core.progress import Progress
from model.io.model_files import find_assets
from model.io.open_asset import open_asset
from model.scenes.registry import read_scene
from model.scenes.unpacking import unpack

FILES = 2000
"""By default."""
SECONDS = 60.0
"""Longest reading of a file of some kilobytes; USD may take half of it by itself."""
MEMORY = 4 << 30
"""Bytes that the reading process may take."""
MOST_UNPACKED = 100_000_000
"""Bytes of a zip."""
BAD = ("crash", "hang", "blow-up", "our fault")
SHOWN = 20


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    files = FILES if options.limit is None else options.limit
    samples = fault_samples()
    counts: dict[str, Counter[str]] = {s.name: Counter() for s in samples}
    bad: list[dict[str, Any]] = []
    with (
        WorkerProcess(
            "faults", initializer=limit_process, arguments=(MEMORY,), threads=1
        ) as worker,
        tempfile.TemporaryDirectory(prefix="artiworld-faults-") as folder,
    ):
        for seed in range(options.seed, options.seed + files):
            progress((seed - options.seed) / max(files, 1), f"file of seed {seed}")
            sample = _sample_of(samples, seed)
            outcome, message = _read(worker, sample, seed, Path(folder))
            counts[sample.name][outcome] += 1
            if outcome in BAD:
                bad.append({"seed": seed, "format": sample.name, "what": outcome, "why": message})
    rows = [
        {"format": name, "files": sum(n.values()), **{k: n[k] for k in ("read", "refused", *BAD)}}
        for name, n in counts.items()
    ]
    report = {"seed": options.seed, "files": files, "rows": rows, "bad": bad}
    if options.kills:
        report["kills"] = kill_servers(options.kills, options.seed, progress)
    if options.clients:
        report["clients"] = click_beside(options.clients, options.seed, progress)
    kills = report.get("kills", {})
    lost = any(row["lost"] for row in report.get("clients", ()))
    report["failed"] = bool(bad or lost or kills.get("lost") or kills.get("left over"))
    return report, lambda: _print(report)


def _sample_of(samples: list[FaultSample], seed: int) -> FaultSample:
    """One format after the other, so that each gets as many files."""
    return samples[seed % len(samples)]


def _read(worker: WorkerProcess, sample: FaultSample, seed: int, root: Path) -> tuple[str, str]:
    """Outcome and message of reading one damaged source."""
    rng = random.Random(f"{seed}")
    name = rng.choice([*sample.files, sample.main])
    folder = root / f"{seed}"
    folder.mkdir()
    for file, data in sample.files.items():
        (folder / file).write_bytes(damaged(data, rng) if file == name else data)
    try:
        job = worker.submit(
            read_source, folder / sample.main, sample.is_scene, most_seconds=SECONDS
        )
        job.result()
    except OutOfTimeError as error:
        return "hang", str(error)
    except ArtiworldError as error:
        return "blow-up" if "into memory" in str(error) else "refused", str(error)
    except WorkerDied as error:
        return "crash", str(error)
    except JobFailed as error:
        return "our fault", error.details or str(error)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return "read", ""


def read_source(path: Path, is_scene: bool) -> int:
    """Read a file, an upload or a scene as the server does; returns the number of what is in it.

    Raises:
        ArtiworldError: where it is refused.
    """
    if is_scene:
        scene = read_scene(path)
        unpack(scene, path.parent / "inside")
        return len(scene.objects)
    if path.suffix == ".zip":
        kept = keep_upload(path.parent / "uploads", path.name, path.read_bytes(), MOST_UNPACKED)
        return sum(open_asset(found).element_count for found in find_assets([kept]))
    return open_asset(path).element_count


def _print(report: dict[str, Any]) -> None:
    print_records(f"{report['files']} damaged files from seed {report['seed']}", report["rows"])
    for entry in report["bad"][:SHOWN]:
        last = entry["why"].strip().splitlines()[-1:]
        said = f"seed {entry['seed']}: {entry['what']}: {entry['format']}: {' '.join(last)}"
        console().print(said, markup=False, highlight=False)
    if len(report["bad"]) > SHOWN:
        console().print(f"{len(report['bad']) - SHOWN} more, with --json")
    if "kills" in report:
        print_records("Servers killed at random moments", [report["kills"]])
    if "clients" in report:
        print_records("Clicks of six people", report["clients"])
