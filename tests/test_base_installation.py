"""The main job with what ``make run`` installs: no package that only an extra brings is there."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from model.core.files import static_assets

ROOT = Path(__file__).parents[1]
REFUSING = """
import sys
class Refusing:
    def __init__(self, finder):
        self._finder = finder
    def __getattr__(self, name):
        return getattr(self._finder, name)
    def find_spec(self, name, *more):
        found = name.partition(".")[0] not in REFUSED
        return self._finder.find_spec(name, *more) if found else None
sys.meta_path[:] = map(Refusing, sys.meta_path)
"""
IMPORT_ALL = """
import importlib
for name in NAMES:
    importlib.import_module(name)
"""
MAIN_JOB = """
from app.cli.main import main
assert main(["segment", SCAN, "--prompts", PROMPTS, "--out", PARTS]) == 0
assert main(["predict", PARTS, "--out", ASSET]) == 0
"""


def base_distributions() -> set[str]:
    """All that an installation without extras brings, by canonical name."""
    found, left = set[str](), [Requirement("artiworld")]
    while left:
        name = canonicalize_name(left.pop().name)
        if name in found:
            continue
        found.add(name)
        try:
            told = [Requirement(text) for text in requires(name) or ()]
        except PackageNotFoundError:
            continue
        left += [r for r in told if r.marker is None or r.marker.evaluate({"extra": ""})]
    return found


def without_extras(code: str, **values: object) -> subprocess.CompletedProcess[str]:
    base = base_distributions()
    refused = {
        module for module, of in packages_distributions().items()
        if not base & {canonicalize_name(name) for name in of}
    }  # fmt: skip
    assert {"tokenizers", "transformers", "mujoco", "pytest"} <= refused
    given = {**values, "REFUSED": sorted(refused)}
    told = f"import json; globals().update(json.loads({json.dumps(given)!r}))"
    return subprocess.run(
        [sys.executable, "-c", told + REFUSING + code], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


@pytest.mark.parametrize("package", ["app", "model", "sessions"])
def test_every_module_can_be_imported(package: str) -> None:
    paths = [p.relative_to(ROOT).with_suffix("") for p in (ROOT / package).rglob("*.py")]
    names = [".".join(p.parts) for p in paths if p.parts[1] != "migrations"]
    names = [n for n in names if not n.endswith(("__init__", "__main__"))]
    done = without_extras(IMPORT_ALL, NAMES=sorted(names))
    assert done.returncode == 0, done.stderr[-2000:]


def test_a_scan_is_segmented_and_predicted(tmp_path: Path) -> None:
    examples = static_assets() / "examples"
    scan, prompts = (str(examples / f"refrigerator_scan.{s}") for s in ("ply", "prompts.json"))
    parts, asset = str(tmp_path / "parts"), tmp_path / "asset"
    done = without_extras(MAIN_JOB, SCAN=scan, PROMPTS=prompts, PARTS=parts, ASSET=str(asset))
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(asset.rglob("*.urdf"))
