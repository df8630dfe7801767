"""Commands say so where a file seems to lie on its back, and ``prepare`` stands it up."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from model.core.asset import Asset
from model.core.files import static_assets
from model.io.open_asset import open_asset
from tests.app.run_cli import artiworld, write_prompts
from tests.raw_scans import saved_along_another_axis

REMARK = "lie on its back or front"


@pytest.fixture(scope="module")
def kettle() -> Asset:
    return open_asset(static_assets() / "examples" / "kettle.glb")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
@pytest.mark.parametrize("upright", [True, False])
def test_prepare_stands_a_file_up_and_leaves_an_upright_one(
    kettle: Asset, tmp_path: Path, suffix: str, upright: bool
) -> None:
    turn = np.eye(3) if upright else None
    path = saved_along_another_axis(kettle, tmp_path / f"scan{suffix}", turn)
    out = tmp_path / "out"
    done = artiworld("prepare", path, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    numbers = open_asset(path, up_axis="z").element_centers
    up = np.array(report["up_in_source"])
    frame = np.array(report["object_from_source"])
    heights = open_asset(out / report["object"]).element_centers[:, 2]
    z = (kettle.element_centers - kettle.bounds[0])[:, 2]
    assert np.abs(np.eye(3) @ up).max() == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(np.sort(heights), np.sort(z), atol=0.02 * z.max())
    whole = np.sort(numbers @ frame[2, :3] + frame[2, 3])
    np.testing.assert_allclose(whole, np.sort(z), atol=0.02 * z.max())
    assert report["tilt_degrees"] == pytest.approx(0.0 if upright else 90.0)


@pytest.mark.parametrize(("upright", "told"), [(True, False), (False, True)])
def test_segment_tells_that_a_file_lies(
    kettle: Asset, tmp_path: Path, upright: bool, told: bool
) -> None:
    path = saved_along_another_axis(kettle, tmp_path / "scan.ply", np.eye(3) if upright else None)
    x, y, z = open_asset(path).element_centers[0].tolist()
    clicks = [{"position": [x, y, z], "part": 1, "positive": True}]
    prompts = write_prompts(tmp_path / "prompts.json", {"format": 1, "clicks": clicks})
    done = artiworld("segment", path, "--prompts", prompts, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    problems = json.loads(done.stdout)["problems"]
    assert any(REMARK in line for line in problems) is told
    predicted = artiworld("predict", tmp_path / "out", "--out", tmp_path / "asset", "--json")
    assert predicted.returncode == 0, predicted.stderr
    assert any(REMARK in p for p in json.loads(predicted.stdout)["problems"]) is told
