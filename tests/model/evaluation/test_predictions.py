"""Other people's files: the oracle loses nothing, and each wrong answer what it should."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject, Part
from model.core.errors import ConfigurationError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.registry import DatasetOptions
from model.evaluation.predictions import ROTATIONS, Frame, Similarity
from model.evaluation.report import Report
from model.evaluation.run import EvaluationConfig, evaluate
from model.evaluation.summary import METRICS
from model.io.export.urdf import UrdfExporter
from tests.builders import boxes, spans

LEVELS = itertools.product(("m", "ma", "mao"), ("precision", "recall", "f1"))
S2O = {f"{level}_{figure}" for level, figure in LEVELS}
WRONG = {"usable", "usable_joints"}
LIMITS = {"range_right", "ald", "ald_all"}
TYPE = WRONG | LIMITS | {"tc", "type_precision"}
LINE = {"opd_all", "opd_line_all"}
RANGE = WRONG | LIMITS | {"range_iou"}


def cabinet() -> ArticulatedObject:
    """A body, a door on it with a knob, a drawer, and a shelf that is fixed."""
    walls = "0 0 0 .6 1 .02  0 0 1.18 .6 1 1.2  0 0 0 .6 .02 1.2 0 .98 0 .6 1 1.2 .58 0 0 .6 1 1.2"
    parts = (
        Part("link_0", boxes(*spans(walls))),
        Part("link_1", boxes(((-0.02, 0, 0.4), (0, 1.0, 1.2)))),
        Part("link_2", boxes(((-0.06, 0.9, 0.7), (-0.02, 0.94, 0.74)))),
        Part("link_3", boxes(((-0.02, 0, 0), (0, 1.0, 0.38)), ((0, 0.1, 0.1), (0.4, 0.9, 0.12)))),
        Part("link_4", boxes(((0.1, 0.05, 0.8), (0.5, 0.95, 0.82)))),
    )
    joints = (
        Joint("door", "revolute", "link_0", "link_1", (0, 0, -1), (0, 0, 0.8), 0.0, 1.6),
        Joint("knob", "continuous", "link_1", "link_2", (1, 0, 0), (-0.04, 0.92, 0.72)),
        Joint("drawer", "prismatic", "link_0", "link_3", (-1, 0, 0), (0, 0, 0), 0.0, 0.4),
        Joint("shelf", "fixed", "link_0", "link_4"),
    )
    links = tuple(p.link for p in parts)
    return ArticulatedObject("cabinet", parts, KinematicTree(links, joints), "StorageFurniture")


def write(obj: ArticulatedObject, folder: Path, edit: Callable[[str], str] = str) -> None:
    folder.mkdir(parents=True)
    UrdfExporter().export(obj, folder)
    path = folder / "object.urdf"
    path.write_text(edit(path.read_text()))


def changed(**joints: dict[str, object]) -> ArticulatedObject:
    obj = cabinet()
    tree = obj.tree
    for name, values in joints.items():
        tree = tree.with_joint(replace(tree.by_name[name], **values))  # type: ignore[arg-type]
    return replace(obj, tree=tree)


def similar(rotation: int, scale: float, shift: tuple[float, ...] = (0, 0, 0)) -> ArticulatedObject:
    return Similarity(ROTATIONS[rotation], scale, np.asarray(shift, float)).object(cabinet())


def renamed() -> ArticulatedObject:
    obj = cabinet()
    names = {p.link: f"link_{9 - i}" for i, p in enumerate(obj.parts)}
    joints = tuple(
        replace(j, name=f"j{i}", parent=names[j.parent], child=names[j.child])
        for i, j in reversed([*enumerate(obj.tree.joints)])
    )
    parts = tuple(replace(p, link=names[p.link]) for p in reversed(obj.parts))
    return replace(obj, parts=parts, tree=KinematicTree(tuple(names.values()), joints))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data")
    write(cabinet(), root / "a")
    return root


def scored(data: Path, folder: Path, **options: Any) -> Report:
    fixed: Any = {"predictor": "they", "predictions": folder, "jobs": 1, "timeout": 900.0}
    return evaluate(EvaluationConfig(DatasetOptions("urdf", data), **fixed, **options))


def lost(report: Report, tolerance: float = 1e-9) -> set[str]:
    """Keys of the metrics that the oracle has and this doesn't."""
    driven = {"joints_executable", "penetration", "drift"}
    driven |= {m.key for m in METRICS if m.key.startswith("executable")}
    right = {m.key: 1.0 if m.higher else 0.0 for m in METRICS if m.key not in driven}
    return {
        k for k, v in right.items() if not math.isclose(report.summary[k], v, abs_tol=tolerance)
    }


def level(start: str = "m", end: str = "") -> set[str]:
    """S2O's figures of a level, without those that end so."""
    return {k for k in S2O if k.startswith(start) and not (end and k.endswith(end))}


def answer(lost: set[str], *text: str, **joints: dict[str, object]) -> Any:
    """The cabinet with some fields of joints changed, a text replaced in its file, what is lost."""
    return lambda: changed(**joints), lambda old: old.replace(*text) if text else old, lost


SIDEWAYS = {"type": "prismatic", "axis": (0, 1, 0), "lower": 0.0, "upper": 0.2}
MISSING = "tc range_right dld dld_all apd_all parent tree tree_edits part_iou parts_found"
BATTERY = {
    "oracle": answer(set()),
    "both flipped": answer(set(), door={"axis": (0, 0, 1), "lower": -1.6, "upper": 0.0}),
    "knob flipped": answer(set(), knob={"axis": (-1, 0, 0)}),
    "drawer's origin": answer(set(), drawer={"origin": (7, 8, 9)}),
    "renamed links": (renamed, str, set()),
    "flipped axis": answer(RANGE, door={"axis": (0, 0, 1)}),
    "swapped limits": answer(RANGE, 'lower="0" upper="1.6"', 'lower="1.6" upper="0"'),
    "shifted origin": answer(
        WRONG | LINE | {"opd", "opd_line"} | level("mao"), door={"origin": (0, 0.5, 0.8)}
    ),
    "turned axis": answer(WRONG | {"apd", "apd_all"} | level("ma"), drawer={"axis": (-1, 0.4, 0)}),
    "wrong type": answer(TYPE, door={"type": "continuous"}),
    "wrong motion": answer(
        TYPE | LINE | S2O, door={"type": "prismatic", "lower": 0.0, "upper": 0.4}
    ),
    "missing joint": answer(
        WRONG | {*MISSING.split()} | level(end="precision"), drawer={"type": "fixed"}
    ),
    "extra joint": answer(
        {"usable", "type_precision", "tree", "tree_edits", "part_iou"} | level(end="recall"),
        shelf=SIDEWAYS,
    ),
    "unparseable joint": answer(
        TYPE | LINE | S2O | {"apd_all"}, '<axis xyz="0 0 -1"/>', '<axis xyz="0, 0, -1"/>'
    ),
}


@pytest.mark.parametrize("name", BATTERY)
def test_each_answer_loses_exactly_what_it_should(name: str, data: Path, tmp_path: Path) -> None:
    make, edit, expected = BATTERY[name]
    write(make(), tmp_path / "they" / "a", edit)
    report = scored(data, tmp_path / "they", frame=Frame())
    assert not report.summary.failed, report.scores[0].problem
    assert lost(report) == expected


@pytest.mark.parametrize(
    ("rotation", "scale", "shift", "said"),
    [
        (0, 10.0, (0, 0, 0), "scaled by 0.1"),
        (1, 1.0, (0, 0, 0), "turned"),
        (7, 0.37, (3.0, -2.0, 1.0), "true box"),
    ],
)
def test_a_method_with_another_frame_loses_nothing_and_it_is_said(
    rotation: int, scale: float, shift: tuple[float, ...], said: str, data: Path, tmp_path: Path
) -> None:
    write(similar(rotation, scale, shift), tmp_path / "they" / "a")
    report = scored(data, tmp_path / "they")
    assert lost(report, 1e-6) == set()  # a box is fitted to single precision
    assert report.frame is not None and said in report.frame
    taken_as_it_is = scored(data, tmp_path / "they", frame=Frame())
    assert taken_as_it_is.summary["parts_found"] < 1 and not taken_as_it_is.scores[0].usable


@pytest.mark.parametrize("what", ["nothing", "no XML", "no mesh"])
def test_what_cannot_be_read_is_a_failure_and_no_end(what: str, data: Path, tmp_path: Path) -> None:
    folder = tmp_path / "they" / "a"
    write(cabinet(), folder, lambda text: "<robot" if what == "no XML" else text)
    if what == "no mesh":
        next((folder / "meshes").glob("*.obj")).unlink()
    if what == "nothing":
        folder.rename(tmp_path / "they" / "b")
        with pytest.raises(ConfigurationError, match="none of its objects"):
            scored(data, tmp_path / "they")
        return
    report = scored(data, tmp_path / "they")
    s = report.summary
    assert (s.failed, s.missing, s["tc"], s["usable"], s["m_recall"]) == (1, 3, 0.0, 0.0, 0.0)
    assert s["part_iou"] == 0.0 and s["apd_all"] == pytest.approx(math.pi / 2)
    assert report.scores[0].problem


def test_an_over_segmented_door_is_one_door(data: Path, tmp_path: Path) -> None:
    obj = cabinet()
    first = Part("link_1", boxes(((-0.02, 0, 0.4), (0, 0.5, 1.2))))
    second = Part("link_9", boxes(((-0.02, 0.5, 0.4), (0, 1.0, 1.2))))
    glue = Joint("glue", "fixed", "link_1", "link_9")
    tree = KinematicTree((*obj.tree.links, "link_9"), (*obj.tree.joints, glue))
    parts = (*(p for p in obj.parts if p.link != "link_1"), first, second)
    write(replace(obj, parts=parts, tree=tree), tmp_path / "they" / "a")
    report = scored(data, tmp_path / "they")
    assert report.scores[0].usable and report.summary["part_iou"] > 0.9


def test_real_objects_through_our_exporter_and_back(shared_data: Path, tmp_path: Path) -> None:
    """Ground truth of real objects, written and read again, is its own best prediction."""
    from model.data.folders import PartNetMobility

    dataset = PartNetMobility(shared_data / "partnet_mobility")
    chosen = [i for i in dataset.ids() if dataset.category(i) in ("Scissors", "Bottle")][:3]
    for object_id in chosen:
        write(dataset.load(object_id).object, tmp_path / "they" / object_id)
    options: Any = {"predictor": "oracle", "predictions": tmp_path / "they", "jobs": 1}
    options |= {"split": "category:Scissors,Bottle", "timeout": 900.0}
    source = DatasetOptions("partnet-mobility", dataset.root)
    report = evaluate(EvaluationConfig(source, **options))
    own = [s for s in report.scores if s.object_id in chosen]
    assert len(own) == 3 and all(s.usable and s.part_iou == pytest.approx(1.0) for s in own)
    assert report.frame == "as it is"
    assert report.summary.failed == len(report.scores) - 3
