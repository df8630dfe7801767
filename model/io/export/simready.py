"""USD as a SimReady package: the layout, metadata and thumbnail of NVIDIA's asset profiles.

``NAME/usd/NAME.usdc`` with its textures, a thumbnail below ``.thumbs``, and ``SimReady_Metadata``
in the root layer, as requirements NP.005, SR.002 and SR.004 of the profile Robotics-Prop 4.0.0 ask
(package ``simready-foundation-tier-core``). Labels, normals and masses are of every USD export.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError
from model.core.files import read_json, static_assets, write_json
from model.core.packages import require
from model.core.progress import Progress
from model.geometry.casting import render
from model.io.export.formats import FileExporter
from model.io.export.usd import UsdExporter
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import Physics

PROFILE, VERSION = "Robotics-Prop", "4.0.0"
VALIDATOR = "simready-validate"
THUMBNAIL = 256
"""Pixels along each side; the requirement names them in the folder."""
REMEMBERED = "simready.json"
"""File of a workspace with the author and licence that were given last."""
_ASKED = ("author", "license")
SECONDS = 300.0
"""Longest run of the validator on one asset."""


@dataclass(frozen=True)
class AboutPackage:
    """Metadata of a package beside those of its object.

    Attributes:
        author: person or organisation. license: such as ``CC-BY-4.0``.
        source: name of the file that it was made of.
        qcode: Wikidata's item of what it is; None for that of its category.
    """

    author: str
    license: str
    source: str = "unknown"
    qcode: str | None = None

    def __post_init__(self) -> None:
        for name, value in (("author", self.author), ("license", self.license)):
            if not value.strip():
                raise ConfigurationError(f"a SimReady package names its {name}: give --{name}")
        if self.qcode is not None and not re.fullmatch(r"Q[0-9]+", self.qcode):
            raise ConfigurationError(f"the Q-code {self.qcode!r} must be Q and digits, as Q15026")


def remembered(workspace: Path | None) -> tuple[str, str]:
    """Author and licence of the last package of a workspace; "" where there was none.

    Raises:
        InputFileError: where the file that remembers them is damaged.
    """
    path = None if workspace is None else workspace / REMEMBERED
    if path is None or not path.is_file():
        return "", ""
    said = read_json(path, "delete it; it holds author and licence of SimReady packages")
    return tuple(str(said.get(k, "")) if isinstance(said, dict) else "" for k in _ASKED)  # type: ignore[return-value]


def remember(workspace: Path | None, about: AboutPackage) -> None:
    """Keep author and licence for the workspace's next package; outside of one nothing is kept."""
    if workspace is not None:
        write_json(workspace / REMEMBERED, {key: getattr(about, key) for key in _ASKED})


class SimReadyExporter(FileExporter):
    """A folder named after the object, ready for Isaac Sim and NVIDIA's validator."""

    name = "usd"

    def __init__(self, about: AboutPackage) -> None:
        self.about = about

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
        name = re.sub(r"\W+", "_", obj.name, flags=re.ASCII).strip("_").lower() or "object"
        inside = folder / name / "usd"
        inside.mkdir(parents=True, exist_ok=True)
        files = UsdExporter(f"{name}.usdc").export(obj, inside, physics=physics, progress=progress)
        self._describe(files[0], obj, physics)
        thumbnail = inside / ".thumbs" / f"{THUMBNAIL}x{THUMBNAIL}" / f"{files[0].name}.png"
        thumbnail.parent.mkdir(parents=True, exist_ok=True)
        shown = tuple(replace(p, mesh=part_mesh(p), cloud=None) for p in obj.parts)
        render(replace(obj, parts=shown), (THUMBNAIL, THUMBNAIL)).save(thumbnail)
        return (*files, thumbnail)

    def _describe(self, path: Path, obj: ArticulatedObject, physics: Physics) -> None:
        sdf, gf = require("pxr.Sdf", "artiworld[usd]", "USD"), require("pxr.Gf", "artiworld[usd]")
        layer = sdf.Layer.FindOrOpen(str(path))
        layer.customLayerData = {
            "SimReady_Metadata": {
                "author": self.about.author,
                "asset_name": obj.name,
                "asset_type": "prop",
                "asset_license": self.about.license,
                "category": (obj.category or "object").lower(),
                "source_file": self.about.source,
                "usd_date_generated": datetime.now(UTC).date().isoformat(),
                "qcode": self.about.qcode or qcode_of(obj.category),
                "rigid_body_count": len(obj.tree.links),
                "asset_extents": gf.Vec3f(*np.ptp(obj.bounds, axis=0).tolist()),
                "mass": float(sum(i.mass for i in physics.inertials.values())),
            }
        }
        layer.Save()


def qcode_of(category: str | None) -> str:
    """Wikidata's item of a category, or of a physical object."""
    table = read_json(static_assets() / "export" / "wikidata.json")
    known = {name.lower(): code for name, code in table["categories"].items()}
    return str(known.get((category or "").lower(), table["default"]))


def validator_installed() -> bool:
    """True if NVIDIA's validator and its profiles are installed."""
    return find_spec("simready") is not None and find_spec("simready.validate") is not None


def simready_problems(path: Path) -> list[str]:
    """Requirements of the profile that NVIDIA's validator finds missing.

    Raises:
        ConfigurationError: where the validator doesn't answer.
    """
    with TemporaryDirectory(prefix="artiworld-") as folder:
        report = Path(folder, "report.json")
        command = [
            sys.executable, "-c", "from simready.validate._cli import main; main()",
            "--profile", PROFILE, "--version", VERSION, "--output", str(report), str(path),
        ]  # fmt: skip
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=SECONDS, check=False
            )
            found = json.loads(report.read_text(encoding="utf-8"))
        except subprocess.TimeoutExpired as error:
            raise ConfigurationError(f"{VALIDATOR} took more than {SECONDS:.0f} s") from error
        except (OSError, ValueError) as error:
            last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no output"]
            raise ConfigurationError(f"{VALIDATOR} gave no report: {last[0]}") from error
    return [line for report in found.values() for line in _problems(report)]


def _problems(report: Mapping[str, Any]) -> list[str]:
    """One line for each requirement that the profile's required features lack."""
    lines: dict[str, str] = {}
    for name, feature in report.get("features_summary", {}).items():
        if not feature.get("blocking_failure"):
            continue
        said = feature.get("requirement_messages") or {}
        said = json.loads(said) if isinstance(said, str) else said
        if not said:
            lines[name] = f"{name}: not met"
        for code, messages in said.items():
            first = str(next(iter(messages), "not met"))
            lines.setdefault(code, f"{code.rpartition('simready.')[2]}: {first}")
    return list(lines.values())
