"""The documents' code runs as it stands there, and their names, links and figures resolve."""

from __future__ import annotations

import ast
import csv
import re
import tomllib
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

import model
from app.cli.main import main
from model.core.articulated_object import Part, SegmentedObject
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.io.assets.reader import load_object
from model.io.export.registry import exporter_names
from model.io.geometry_files import SUFFIXES
from model.prediction.registry import Predictor

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "static_assets" / "examples"


def blocks(document: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)


def run(code: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run an example in a folder where the repository's files are."""
    (folder / "static_assets").symlink_to(ROOT / "static_assets")
    monkeypatch.chdir(folder)
    exec(compile(code, "example.py", "exec"), {"__name__": "__main__"})


def test_the_example_of_the_readme_makes_an_oven_that_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (code,) = blocks("README.md", "python")
    assert len([line for line in code.splitlines() if "import" not in line and line]) <= 12
    run(code, tmp_path, monkeypatch)
    oven = load_object(tmp_path / "oven")
    assert oven.category == "Oven"
    joints = {j.child: j for j in oven.tree.joints}
    door, drawer = joints["door_1"], joints["drawer_2"]
    assert door.type == "revolute" and np.abs(np.dot(door.axis, (1, 0, 0))) > 0.99
    assert drawer.type == "prismatic" and np.dot(drawer.axis, (0, -1, 0)) > 0.99


def test_the_example_of_the_api_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = (block for block in blocks("docs/api.md", "python") if "validate(" in block)
    run(code, tmp_path, monkeypatch)
    types = [j.type for j in load_object(tmp_path / "cabinet").tree.joints]
    assert types == ["revolute", "prismatic"]


def test_the_api_page_has_every_public_name_once() -> None:
    listed = re.findall(r"^::: model\.(\w+)$", (ROOT / "docs/api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(model.__all__)


@pytest.fixture(scope="module")
def plug_ins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of docs/extending.md, as an installer would lay it down."""
    folder = tmp_path_factory.mktemp("site")
    for code in blocks("docs/extending.md", "python"):
        file = folder / code.splitlines()[0].removeprefix("# ")
        file.parent.mkdir(exist_ok=True)
        file.write_text(code)
    (project,) = blocks("docs/extending.md", "toml")
    points = tomllib.loads(project)["project"]["entry-points"]
    info = folder / "your_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: your_package\nVersion: 1.0\n")
    groups = {group: [f"{k} = {v}" for k, v in named.items()] for group, named in points.items()}
    lines = [line for group in groups for line in (f"[{group}]", *groups[group])]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return folder


def test_plug_ins_of_the_documents_segment_predict_and_export(
    plug_ins: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, prompts = EXAMPLES / "cabinet.glb", EXAMPLES / "cabinet.prompts.json"
    monkeypatch.syspath_prepend(plug_ins)
    monkeypatch.chdir(tmp_path)

    def artiworld(*words: str | Path) -> int:
        return main([*map(str, words)])

    words = f"segment {scan} --prompts {prompts} --segmenter balls --out parts"
    assert artiworld(*words.split()) == 0
    assert artiworld("predict", "parts", "--predictor", "drawers", "--out", "made") == 0
    words = "export made --format joint-table,urdf --out out --no-collision --check"
    assert artiworld(*words.split()) == 0
    with (tmp_path / "out" / "joint-table" / "joints.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    tree = load_object(tmp_path / "made").tree
    assert [r["joint"] for r in rows] == [j.name for j in tree.joints] and rows
    assert {r["axis"] for r in rows} == {"0 -1 0"}
    words = "evaluate --data saved-assets --root . --predictor drawers --jobs 1 --out run"
    assert artiworld(*words.split()) == 0
    assert (tmp_path / "run" / "report.json").is_file()
    # A format that nothing can read back doesn't spoil what can be.
    assert artiworld("check", "made", "--no-collision", "--allow-broken") == 0
    assert artiworld("check", "made", "--no-collision", "--format", "joint-table") == 2


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


DOCUMENTS = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


def test_the_panel_of_the_documents_draws() -> None:
    (code,) = (b for b in blocks("docs/architecture.md", "python") if "panels" in b)
    names: dict[str, Any] = {}
    exec(compile(code, "part_count.py", "exec"), names)
    tab = MagicMock()
    panel = names["PartCount"](tab)
    panel.draw(MagicMock(document=MagicMock(parts=(1, 2, 3))))
    assert tab.client.gui.add_markdown().content == "3 parts"


def test_the_proposal_source_of_the_documents_proposes() -> None:
    (code,) = (b for b in blocks("docs/architecture.md", "python") if "Remainder" in b)
    names: dict[str, Any] = {}
    exec(compile(code, "remainder.py", "exec"), names)
    source = names["Remainder"](range(5))
    (proposals,) = source.first(3, (0, 1))
    assert proposals.masks.tolist() == [[False, False, True, True, True]]
    assert source.later(None, None, 3, True) == []


def headings(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub and the site make them."""
    text = re.sub(r"```.*?```", "", document.read_text(), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_links_between_documents_lead_somewhere() -> None:
    assert len(DOCUMENTS) > 20
    broken = []
    for document in DOCUMENTS:
        for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", document.read_text()):
            file, _, anchor = link.partition("#")
            target = document.parent / file if file else document
            if not target.exists() or (anchor and anchor not in headings(target)):
                broken.append((document.name, link))
    assert not broken


def test_every_page_is_in_the_navigation() -> None:
    navigation = re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text())
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert pages <= set(navigation)
    assert all((ROOT / name).exists() for name in set(navigation) - pages)


def known_names(module: Path) -> set[str]:
    """Names that a module or package defines or imports, and ``Class.member``."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.ClassDef):
            for inner in ast.walk(node):
                if isinstance(inner, ast.FunctionDef | ast.ClassDef):
                    found.add(f"{node.name}.{inner.name}")
                elif isinstance(inner, ast.AnnAssign) and isinstance(inner.target, ast.Name):
                    found.add(f"{node.name}.{inner.target.id}")
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def is_there(name: str) -> bool:
    """Whether a dotted name of ours is a module, or something in one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:length])
        if path.is_dir() and length == len(parts):
            return True
        for module in (path.with_suffix(".py"), path / "__init__.py"):
            if module.is_file():
                rest = ".".join(parts[length:])
                return not rest or rest in known_names(module)
    return False


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda d: d.relative_to(ROOT).as_posix())
def test_paths_and_names_in_documents_are_there(document: Path) -> None:
    text = re.sub(r"```.*?```", "", document.read_text(), flags=re.DOTALL)
    quoted = re.findall(r"`([\w./-]+)`", text)
    ours = re.compile(r"(app|model|sessions|static_assets|tests|docs)[/.]")
    missing = [
        name
        for name in quoted
        if ours.match(name) and "NAME" not in name
        if not (ROOT / name).exists() and ("/" in name or not is_there(name))
    ]
    assert not missing


def test_the_picture_of_the_layers_shows_those_that_are_held() -> None:
    shown = re.findall(r'class="name"[^>]*>([\w/]+)<', (ROOT / "docs/architecture.svg").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = project["tool"]["importlinter"]["contracts"]
    packages, app, inside = (c["layers"] for c in contracts if c["type"] == "layers")
    assert packages == ["app", "sessions", "model"]
    assert shown == [layer.replace(".", "/") for layer in [*app, "sessions", *inside]]


def test_each_convention_takes_one_line() -> None:
    rows = [r for r in (ROOT / "CONVENTIONS.md").read_text().splitlines() if r.startswith("| ")]
    assert len(rows) > 40
    for row in rows[1:]:
        convention, _, test = (cell.strip() for cell in row.strip("|").split(" | "))
        assert len(convention) <= 170, convention
        assert test, convention


def test_options_in_documents_exist() -> None:
    reference = ROOT / "docs" / "command-line.md"
    option = re.compile(r"(?<![\w-])--[a-z][\w-]+[a-z]")
    known = set(option.findall(reference.read_text()))
    known |= {"--multi_gpu", "--num_processes", "--config_file", "--skip"}  # accelerate; training
    known |= {"--urdf"}  # of modules in model.training
    unknown = {
        (document.name, name)
        for document in DOCUMENTS
        for name in option.findall(document.read_text())
        if name not in known
    }
    assert not unknown


def test_documents_use_the_words_of_the_field() -> None:
    private = re.compile(r"\b(gate|mend\w*|made objects?|stray|crumbs?|close-ups?|in vain)\b")
    found = {
        (document.name, word)
        for document in DOCUMENTS
        for word in private.findall(re.sub(r"--[\w-]+", "", document.read_text()).lower())
    }
    assert not found


def test_the_readme_is_short() -> None:
    text = (ROOT / "README.md").read_text()
    words = [w for line in text.splitlines() if not line.startswith("|") for w in line.split()]
    assert len(words) <= 700


def test_the_changelog_keeps_its_form() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    assert len(text.split()) <= 2000
    versions = re.findall(r"^## (.*)$", text, re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert versions[0] == "[Unreleased]"
    assert versions[1].startswith(f"[{project['version']}] - ")
    assert all(re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", v) for v in versions[1:])
    groups = re.findall(r"^### (.*)$", text, re.MULTILINE)
    assert set(groups) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_every_format_that_is_read_and_written_is_listed() -> None:
    text = (ROOT / "docs" / "formats.md").read_text()
    assert all(f"`{suffix}`" in text for suffix in SUFFIXES)
    assert all(f"`{name}`" in text for name in exporter_names())


def test_every_picture_is_shown_and_can_be_taken_anew() -> None:
    shown = "".join(document.read_text() for document in DOCUMENTS)
    script = (ROOT / "tests" / "browser" / "pictures.py").read_text()
    for picture in (ROOT / "docs" / "pictures").iterdir():
        assert f"pictures/{picture.name})" in shown and f'"{picture.stem}"' in script, picture.name
        assert picture.stat().st_size < 2_000_000


def test_the_citation_names_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"version: {project['version']}\n" in citation
    assert f"license: {project['license']}\n" in citation
