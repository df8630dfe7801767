"""What the documents say is done: their code runs as it stands there."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model.core.articulated_object import Part, SegmentedObject
from model.core.joint import Joint
from model.core.point_cloud import PointCloud
from model.io.assets.reader import load_object
from model.prediction.protocol import Predictor

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "static_assets" / "examples"


def blocks(document: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)


def run(words: list[str], cwd: Path, *more: Path) -> None:
    path = os.pathsep.join(map(str, (*more, ROOT)))
    subprocess.run(
        [sys.executable, *words], cwd=cwd, check=True, env={**os.environ, "PYTHONPATH": path}
    )


def test_the_example_of_the_readme_makes_an_oven_that_opens(tmp_path: Path) -> None:
    (code,) = blocks("README.md", "python")
    assert len([line for line in code.splitlines() if "import" not in line and line]) <= 12
    (tmp_path / "static_assets").symlink_to(ROOT / "static_assets")
    run(["-c", code], tmp_path)
    oven = load_object(tmp_path / "oven")
    assert oven.category == "Oven"
    joints = {j.child: j for j in oven.tree.joints}
    door, drawer = joints["link_1"], joints["link_2"]
    assert door.type == "revolute" and np.abs(np.dot(door.axis, (1, 0, 0))) > 0.99
    assert drawer.type == "prismatic" and np.dot(drawer.axis, (0, -1, 0)) > 0.99


@pytest.fixture(scope="module")
def plug_ins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of docs/extending.md, as an installer would lay it down."""
    folder = tmp_path_factory.mktemp("site")
    for code in blocks("docs/extending.md", "python"):
        file = folder / code.splitlines()[0].removeprefix("# ")
        file.parent.mkdir(exist_ok=True)
        file.write_text(code)
    (told,) = blocks("docs/extending.md", "toml")
    points = tomllib.loads(told)["project"]["entry-points"]
    info = folder / "your_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: your_package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("".join(
        f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in named.items())
        for group, named in points.items()
    ))  # fmt: skip
    return folder


def test_plug_ins_of_the_documents_segment_predict_and_export(
    plug_ins: Path, tmp_path: Path
) -> None:
    scan, prompts = EXAMPLES / "cabinet.glb", EXAMPLES / "cabinet.prompts.json"

    def artiworld(*words: str | Path) -> None:
        run(["-m", "app.cli.main", *map(str, words)], tmp_path, plug_ins)

    artiworld("segment", scan, "--prompts", prompts, "--segmenter", "balls", "--out", "parts")
    artiworld("predict", "parts", "--predictor", "drawers", "--out", "made")
    artiworld("export", "made", "--format", "joint-table,urdf", "--out", "out", "--no-collision",
              "--check")  # fmt: skip
    with (tmp_path / "out" / "joint-table" / "joints.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    tree = load_object(tmp_path / "made").tree
    assert [r["joint"] for r in rows] == [j.name for j in tree.joints] and rows
    assert {r["axis"] for r in rows} == {"0 -1 0"}
    # A format that nothing can read back doesn't spoil what can be.
    artiworld("check", "made", "--no-collision", "--allow-broken")
    with pytest.raises(subprocess.CalledProcessError) as refused:
        artiworld("check", "made", "--no-collision", "--format", "joint-table")
    assert refused.value.returncode == 2


def test_settled_joints_stay_in_the_predictor_of_the_documents(plug_ins: Path) -> None:
    code = (plug_ins / "your_package" / "predictor.py").read_text()
    names: dict[str, Any] = {}
    exec(compile(code, "predictor.py", "exec"), names)
    cloud = PointCloud(np.random.default_rng(0).random((50, 3), np.float32))
    small = PointCloud(cloud.points * np.float32(0.5))
    parts = (Part("link_0", cloud=cloud), Part("link_1", cloud=small), Part("link_2", cloud=small))
    settled = Joint("mine", "revolute", "link_2", "link_1", (0, 0, 1), (0, 0, 0), 0, 1)
    predictor = names["Drawers"]()
    assert isinstance(predictor, Predictor)
    found = predictor.predict(SegmentedObject("o", parts), locked=(settled,))
    assert found.tree is not None and found.joint("link_1") == settled
    turned = Joint("mine", "revolute", "link_1", "link_0", (0, 0, 1), (0, 0, 0), 0, 1)
    found = predictor.predict(SegmentedObject("o", parts), locked=(turned,))
    assert found.tree is not None and found.joint("link_0") == turned
    back = Joint("yours", "revolute", "link_0", "link_1", (0, 0, 1), (0, 0, 0), 0, 1)
    refused = predictor.predict(SegmentedObject("o", parts), locked=(turned, back))
    assert refused.tree is None and refused.problems


def headings(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", document.read_text(), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_links_between_documents_lead_somewhere() -> None:
    documents = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    assert len(documents) > 10
    broken = []
    for document in documents:
        for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", document.read_text()):
            file, _, anchor = link.partition("#")
            target = document.parent / file if file else document
            if not target.exists() or (anchor and anchor not in headings(target)):
                broken.append((document.name, link))
    assert not broken


def test_every_picture_is_shown_and_can_be_taken_anew() -> None:
    shown = "".join((ROOT / name).read_text() for name in ("README.md", "docs/annotating.md"))
    script = (ROOT / "tests" / "browser" / "pictures.py").read_text()
    for picture in (ROOT / "docs" / "pictures").iterdir():
        assert f"pictures/{picture.name})" in shown and f'"{picture.stem}"' in script, picture.name


def test_the_citation_names_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    told = (ROOT / "CITATION.cff").read_text()
    assert f"version: {project['version']}\n" in told
    assert f"license: {project['license']}\n" in told
