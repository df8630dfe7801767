"""``artiworld doctor``: packages, plug-ins, files and machine, with remedies."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, Literal

from rich.text import Text
from sqlalchemy import create_engine, exc, inspect, text
from sqlalchemy.engine import make_url

from app.cli import output
from app.cli.commands import DoctorCommand
from app.cli.output import Result
from app.server.network import check_address
from app.server.workers import MEMORY
from model.core.errors import ArtiworldError
from model.core.files import static_assets
from model.core.memory import machine_memory
from model.core.packages import install_command
from model.core.progress import Progress
from model.io.model_files import find_assets
from model.prediction.registry import load_predictor, predictor_names
from model.scenes.registry import load_reader, reader_names
from model.segmentation.registry import load_segmenter, segmenter_names
from sessions.database import FORMAT, known_formats

Status = Literal["fine", "note", "wrong"]
MIN_MEMORY_GB = 4.0
MIN_DISK_GB = 2.0
OPTIONAL = (
    ("mujoco", "drives joints, opens MJCF, reads URDF and MJCF back", "physics"),
    ("sapien", "drives joints in PhysX, with --engine sapien", "sapien"),
    ("coacd", "another way to make collision shapes", "collision"),
    ("usd-core", "reads and writes USD", "usd"),
    ("pygltflib", "reads GLB back", "readers"),
    ("pybullet", "reads URDF and SDF back", "readers"),
    ("openai", "asks language models what in a scene can be articulated", "finder"),
    ("ray", "converts scenes on a cluster", "cluster"),
    ("playwright", "drives browser tests", "test"),
)
"""Packages of the extras: name, use, extra."""
WEIGHT_SUFFIXES = (".npz", ".safetensors", ".pt")


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: the thing examined.
        status: "fine"; "note" where something optional is missing; "wrong" where ArtiWorld can't
            work.
        found: its version, size or fault.
        remedy: an instruction, or "".
    """

    name: str
    status: Status
    found: str
    remedy: str = ""


def doctor(options: DoctorCommand, _: Progress) -> Result:
    """Examine everything; the exit code is 1 where something is wrong."""
    checks = examine(options.workspace, options.database, options.port)
    report = to_json(checks)
    return Result(report, lambda: _print(checks), int(not report["ok"]))


def examine(workspace: Path, database: str | None = None, port: int = 8080) -> list[Check]:
    """All findings, in the order of the table. Changes nothing on the machine."""
    return [
        Check("python", "fine", f"{platform.python_version()} ({sys.executable})"),
        *check_packages(),
        *_optional(),
        *check_plugins(),
        *_weights(),
        _examples(),
        _workspace(workspace),
        check_database(workspace, database),
        check_port(port),
        _processors(),
        _memory(),
    ]


def to_json(checks: list[Check]) -> dict[str, Any]:
    """The findings, and whether all are well."""
    return {
        "ok": all(check.status != "wrong" for check in checks),
        "checks": [asdict(check) for check in checks],
    }


def check_packages() -> Iterator[Check]:
    """Check that the required packages are installed, in versions that fit."""
    try:
        needed = requires("artiworld") or []
        yield Check("artiworld", "fine", version("artiworld"))
    except PackageNotFoundError:
        remedy = f"run: {install_command('-e', '.')} (or: make run)"
        yield Check("artiworld", "wrong", "not installed", remedy)
        return
    for line in needed:
        if "extra ==" in line.replace('"', "").replace("'", ""):
            continue
        name = re.split(r"[^A-Za-z0-9_.-]", line, maxsplit=1)[0]
        pinned = re.search(r"==\s*([\w.]+)", line)
        try:
            found = version(name)
        except PackageNotFoundError:
            found = "not installed"
        if found == "not installed" or (pinned is not None and found != pinned.group(1)):
            yield Check(name, "wrong", found, f"run: {install_command(line)}")
        else:
            yield Check(name, "fine", found)


def _optional() -> Iterator[Check]:
    yield check_torch()
    for name, use, extra in OPTIONAL:
        try:
            yield Check(name, "fine", version(name))
        except PackageNotFoundError:
            remedy = f"run: {install_command(f'artiworld[{extra}]')}"
            yield Check(name, "note", f"not installed ({use})", remedy)
    browser = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )
    if browser:
        yield Check("chromium", "fine", browser)
    else:
        found = "not found (browser tests are skipped)"
        yield Check("chromium", "note", found, "run: apt-get install chromium")


def check_torch() -> Check:
    """PyTorch and the GPU."""
    if importlib.util.find_spec("torch") is None:
        found = "torch is not installed; without it joints come from geometry alone"
        return Check("gpu", "note", found, f"run: {install_command('torch')}")
    try:
        import torch  # pyright: ignore[reportMissingImports]

        gpu = "no GPU: networks run on the CPU"
        if torch.cuda.is_available():
            gpu = torch.cuda.get_device_name()
        return Check("gpu", "fine", f"torch {torch.__version__}, {gpu}")
    except (ImportError, OSError, RuntimeError) as error:
        remedy = "install torch again, see constraints.txt for the version"
        return Check("gpu", "note", f"torch can't be used: {_line(error)}", remedy)


def check_plugins() -> Iterator[Check]:
    """Check that each predictor, segmenter and scene reader loads."""
    for kind, names, load in (
        ("predictor", predictor_names(), load_predictor),
        ("segmenter", segmenter_names(), load_segmenter),
        ("scene format", reader_names(), load_reader),
    ):
        for name in names:
            try:
                load(name)
            except ArtiworldError as error:
                yield Check(f"{kind} {name}", "note", "can't be used", _line(error))
            except Exception as error:  # a plug-in may fail in any way
                found = f"can't be loaded: {type(error).__name__}: {_line(error)}"
                yield Check(f"{kind} {name}", "note", found, "fix or remove the plug-in")
            else:
                yield Check(f"{kind} {name}", "fine", "usable")


def _weights() -> Iterator[Check]:
    root = static_assets()
    found = sorted(p for p in root.rglob("*") if p.suffix in WEIGHT_SUFFIXES and p.is_file())
    for path in found:
        size = path.stat().st_size
        name = f"weights {path.relative_to(root)}"
        if size == 0:
            yield Check(name, "wrong", "empty", "get the file again (git checkout)")
        else:
            yield Check(name, "fine", f"{size / 1e6:.2f} MB")
    if not found:
        yield Check("weights", "note", f"none in {root}", "get the files again (git checkout)")


def _examples() -> Check:
    folder = static_assets() / "examples"
    try:
        return Check("examples", "fine", f"{len(find_assets([folder]))} objects")
    except ArtiworldError as error:
        return Check("examples", "note", _line(error), "name a file: artiworld serve PATH")


def _workspace(workspace: Path) -> Check:
    folder = workspace.absolute()
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    remedy = "choose another folder with --workspace"
    if not existing.is_dir():
        return Check("workspace", "wrong", f"{existing} is a file", remedy)
    if not os.access(existing, os.W_OK | os.X_OK):
        return Check("workspace", "wrong", f"{folder} can't be written", remedy)
    free = shutil.disk_usage(existing).free / 1e9
    found = f"{folder}{'' if folder.exists() else ' (will be made)'}, {free:.0f} GB free"
    if free < MIN_DISK_GB:
        return Check("workspace", "wrong", found, f"free {MIN_DISK_GB:.0f} GB, or use --workspace")
    return Check("workspace", "fine", found)


def check_database(workspace: Path, url: str | None) -> Check:
    """Check that the database can be read; writes nothing."""
    file = workspace / "artiworld.db"
    none_yet = Check("database", "fine", f"none yet; a new one gets format {FORMAT}")
    if url is None and not file.exists():
        return none_yet
    try:
        # Read-only: makes no file and takes no lock.
        at = make_url(url or f"sqlite:///file:{file.absolute()}?mode=ro&uri=true")
        missing = url is not None and at.get_backend_name() == "sqlite"
        if missing and not (at.database and Path(at.database).exists()):
            return none_yet
        with create_engine(at).connect() as connection:
            if "alembic_version" not in inspect(connection).get_table_names():
                raise LookupError("no table of versions")
            found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
    except (exc.SQLAlchemyError, ImportError, LookupError, OSError) as error:
        reason = _line(getattr(error, "orig", None) or error)
        return Check("database", "wrong", reason, "check --database, or move the file away")
    if found not in known_formats():
        newer = f"format {found}, but this version knows up to {FORMAT}"
        return Check("database", "wrong", newer, "use the newer ArtiWorld that wrote it")
    older = "" if found == FORMAT else f", is migrated to {FORMAT} at the next start"
    return Check("database", "fine", f"format {found}{older}")


def check_port(port: int) -> Check:
    """Check that the server could listen on ``port``."""
    try:
        check_address("127.0.0.1", port)
    except ArtiworldError as error:
        return Check("port", "note", _line(error), "serve takes the next free one")
    return Check("port", "fine", f"{port} is free")


def _processors() -> Check:
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    count = count or 1
    if count < 2:
        return Check("processors", "note", str(count), "long work will delay the browser")
    return Check("processors", "fine", str(count))


def _memory() -> Check:
    total = machine_memory() / 1e9
    found = f"{total:.1f} GB, of which people's objects take at most {MEMORY * total:.1f}"
    if total < MIN_MEMORY_GB:
        return Check("memory", "note", found, f"large scans need {MIN_MEMORY_GB:.0f} GB or more")
    return Check("memory", "fine", found)


def _line(error: object) -> str:
    return " ".join(str(error).split())


def _print(checks: list[Check]) -> None:
    styles = {"fine": "green", "note": "yellow", "wrong": "bold red"}
    output.print_records(
        None,
        [{"": Text(c.status, styles[c.status]), "what": c.name, "found": c.found} for c in checks],
    )
    for c in checks:
        if c.remedy:
            output.print_notes([f"{c.name}: {c.remedy}"], c.status, styles[c.status])
