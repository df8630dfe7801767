"""The page of all methods side by side."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.cli.main import main
from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import Material
from model.evaluation import rivals
from model.evaluation.predictions import longest_edge
from tests.model.evaluation.test_predictions import cabinet, changed, write


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """Two cabinets; a method that has one of them, with the door's hinge on the wrong side."""
    pytest.importorskip("mujoco")
    root = tmp_path_factory.mktemp("rivals")
    for name in ("a", "b"):
        write(cabinet(), root / "truth" / name)
    wrong = changed(door={"origin": (0.0, 1.0, 0.8), "axis": (0.0, 0.0, 1.0)})
    write(wrong, root / "outputs/<b>other/a")
    (root / "outputs/<b>other/seconds.json").write_text('{"a": 12.5}')
    (root / "outputs/notes").mkdir()
    words = ["bench", "rivals", "--root", str(root / "outputs"), "--data", str(root / "truth")]
    with pytest.MonkeyPatch.context() as patch:  # the network takes longer to load than all else
        patch.setitem(rivals.OURS, "ours", "geometric")
        assert main([*words, "--jobs", "1", "--json"]) == 0
    return root / "outputs", json.loads((root / "outputs/rivals.json").read_text())


def test_all_methods_are_in_it_with_their_figures(page: tuple[Path, dict]) -> None:
    _, said = page
    assert list(said) == ["ours", "geometry alone", "longest edge", "<b>other"]
    other, plain = said["<b>other"], said["longest edge"]
    assert other["failed"] == 1 and other["s"] == 12.5
    assert other["TC %"] == pytest.approx(0.5), "the joints of the object that isn't there count"
    assert other["executable %"] is not None and said["ours"]["s"] > 0
    for ours in ("ours", "geometry alone", "longest edge"):
        assert said[ours]["chamfer"] == 0 and said[ours]["color"] == 0
    assert other["chamfer"] < 0.01
    assert plain["MAO f1 %"] < said["ours"]["MAO f1 %"]


def test_pictures_of_the_same_objects_stand_in_a_row(page: tuple[Path, dict]) -> None:
    root, _ = page
    text = (root / "rivals.html").read_text()
    for row in ("a", "b"):
        for method in ("input", "ours", "geometry alone", "longest edge"):
            assert f'alt="{row}: {method}"' in text
    assert 'alt="a: &lt;b&gt;other"' in text and 'alt="b: &lt;b&gt;other"' not in text
    assert "no prediction" in text and "<b>" not in text
    assert "Articulate-Anything, new categories (paper)" in text


def test_geometry_kept_tells_shape_and_colour() -> None:
    truth = cabinet()
    assert rivals.geometry_kept(truth, truth) == (0, 0)
    doors = tuple(replace(p, mesh=shifted(p, 0.1)) for p in truth.parts)
    chamfer, _ = rivals.geometry_kept(truth, replace(truth, parts=doors))
    assert 0.005 < chamfer < 0.1 / 1.6
    black = replace(truth, parts=tuple(replace(p, mesh=painted(p, 0)) for p in truth.parts))
    white = replace(truth, parts=tuple(replace(p, mesh=painted(p, 255)) for p in truth.parts))
    assert rivals.geometry_kept(black, white) == pytest.approx((0, 1), abs=0.02)


def shifted(part, by: float):
    return replace(part.mesh, vertices=part.mesh.vertices + [by, 0, 0])


def painted(part, grey: int):
    return replace(part.mesh, materials=(Material("plain", (grey, grey, grey, 255)),))


def test_the_baseline_hinges_each_part_at_its_longest_edge() -> None:
    obj = cabinet()
    tree = longest_edge(SegmentedObject("cabinet", obj.parts)).tree
    assert tree is not None and tree.root == "link_0"
    ArticulatedObject("cabinet", obj.parts, tree)
    door = tree.joint_of["link_1"]
    assert door.type == "revolute" and np.abs(door.axis).tolist() == [0, 1, 0]
    x, _, z = door.origin
    # Of the four edges along y the one nearest to the body's middle, (0.3, 0.5, 0.6).
    assert (x, z) == pytest.approx((0.0, 0.4)) and door.upper == pytest.approx(math.pi / 2)


def test_wrong_folders_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no such folder"):
        rivals.methods_in(tmp_path / "nothing")
    write(cabinet(), tmp_path / "ours/a")
    with pytest.raises(ConfigurationError, match="rename the folder"):
        rivals.methods_in(tmp_path)


def test_the_root_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "rivals"]) == 2
    assert "--root" in capsys.readouterr().err
