"""Parts in, tree out: with weights that know nothing, odd inputs, settled joints."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed")

import torch

from model.core.articulated_object import Part, SegmentedObject
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.core.progress import BY_DEFAULT, NAMES, with_threads
from model.data.procedural.generate import make
from model.evaluation.joint_metrics import parents
from model.kinematics.siblings import share_confidence
from model.prediction.arti4urdf import decoding
from model.prediction.arti4urdf.answer import parse_answer
from model.prediction.arti4urdf.choosing import HybridSettings
from model.prediction.arti4urdf.decoding import decode
from model.prediction.arti4urdf.network import ArtiModel, token_tensors
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, make_prompt
from model.prediction.arti4urdf.structure import read_structure
from model.prediction.builder import load_confidence
from model.prediction.geometric.predictor import GeometricPredictor


def _parts(family: str, index: int = 0) -> SegmentedObject:
    obj = make(family, 11, index).object
    return SegmentedObject(obj.name, obj.parts, obj.category)


@pytest.mark.parametrize("family", ["StorageFurniture", "Bottle", "Cart", "Eyeglasses"])
@pytest.mark.parametrize("hybrid", [None, HybridSettings()])
def test_random_weights_still_write_a_tree(
    tiny_model: ArtiModel, family: str, hybrid: HybridSettings | None
) -> None:
    segmented = _parts(family)
    found = Arti4UrdfPredictor(tiny_model, hybrid=hybrid).predict(segmented)
    assert found.tree is not None
    assert {p.link for p in segmented.parts} <= set(found.tree.links)
    tree, problems = parse_answer(found.raw_text)
    assert tree is not None and problems == ()
    assert all(0 <= c <= 1 for c in found.confidence.values())


def test_the_same_parts_give_the_same_answer(tiny_model: ArtiModel) -> None:
    predictor, segmented = Arti4UrdfPredictor(tiny_model), _parts("Oven")
    assert predictor.predict(segmented).raw_text == predictor.predict(segmented).raw_text


@pytest.mark.parametrize(
    ("environment", "threads"),
    [
        ({}, 1),
        ({"OMP_NUM_THREADS": "3"}, 3),
        (with_threads({}, 3), 1),
        (with_threads({"MKL_NUM_THREADS": "3"}, 2), 3),
    ],
)
def test_the_network_computes_on_one_thread_unless_the_person_says_otherwise(
    environment: dict[str, str],
    threads: int,
    tiny_model: ArtiModel,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in (*NAMES, BY_DEFAULT):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    seen = []

    def look(*how):
        seen.append(torch.get_num_threads())
        return token_tensors(*how)

    monkeypatch.setattr(decoding, "token_tensors", look)
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        Arti4UrdfPredictor(tiny_model).predict(_parts("Oven"))
        assert set(seen) == {threads}
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


def test_forced_spans_change_nothing_but_the_number_of_passes(tiny_model: ArtiModel) -> None:
    segmented = _parts("StorageFurniture", 1)
    prompt = make_prompt(read_structure(segmented), segmented, 0)
    spans, single = decode(tiny_model, prompt), decode(tiny_model, prompt, span=False)
    assert spans.tokens == single.tokens
    assert spans.decisions == single.decisions
    assert spans.passes < single.passes


def test_settled_joints_come_out_as_they_are(tiny_model: ArtiModel) -> None:
    segmented = _parts("StorageFurniture", 2)
    links = [p.link for p in segmented.parts]
    settled = Joint("mine", "revolute", links[0], links[1], (0, 0, 1), (0.1, 0.2, 0.3), -0.25, 1.5)
    found = Arti4UrdfPredictor(tiny_model).predict(segmented, locked=(settled,))
    assert found.tree is not None
    assert found.tree.joint_of[links[1]] == settled
    assert found.confidence[links[1]] == 1.0


@pytest.mark.parametrize("family", ["StorageFurniture", "Dishwasher", "Cart"])
def test_geometry_decides_the_tree_of_the_hybrid(tiny_model: ArtiModel, family: str) -> None:
    segmented = _parts(family, 2)
    hybrid = Arti4UrdfPredictor(tiny_model, hybrid=HybridSettings()).predict(segmented)
    plain = GeometricPredictor().predict(segmented)
    parts = frozenset(p.link for p in segmented.parts)
    assert hybrid.tree is not None and plain.tree is not None
    assert parents(hybrid.tree, parts) == parents(plain.tree, parts)


def test_a_settled_joint_may_turn_the_tree_of_the_hybrid_over(tiny_model: ArtiModel) -> None:
    segmented = _parts("StorageFurniture", 2)
    predictor = Arti4UrdfPredictor(tiny_model, hybrid=HybridSettings())
    first = predictor.predict(segmented).tree
    assert first is not None
    child = next(p.link for p in segmented.parts if p.link != first.root)
    settled = Joint("mine", "revolute", child, first.root, (0, 0, 1), (0.1, 0.2, 0.3), -0.2, 1.5)
    found = predictor.predict(segmented, locked=(settled,)).tree
    assert found is not None and found.joint_of[first.root] == settled
    assert {p.link for p in segmented.parts} <= set(found.links)


def _cloud(points: np.ndarray, link: str) -> Part:
    return Part(link, cloud=PointCloud(points.astype(np.float32)))


def _odd_objects() -> dict[str, tuple[Part, ...]]:
    rng = np.random.default_rng(0)
    base = rng.random((400, 3))
    return {
        "one part": (_cloud(base, "link_0"),),
        "a part of three points": (_cloud(base, "link_0"), _cloud(base[:3] + 1, "link_1")),
        "a part of one point": (_cloud(base, "link_0"), _cloud(base[:1], "link_1")),
        "far apart": (_cloud(base, "link_0"), _cloud(base + 100, "link_1")),
        "coincident": (_cloud(base, "link_0"), _cloud(base, "link_1"), _cloud(base, "link_2")),
        "all in one place": (_cloud(base * 0, "link_0"), _cloud(base * 0, "link_1")),
        "flat": (_cloud(base * [1, 1, 0], "link_0"), _cloud(base * [1, 1, 0] + 0.1, "link_1")),
    }


@pytest.mark.parametrize("what", list(_odd_objects()))
def test_odd_objects_get_an_answer(tiny_model: ArtiModel, what: str) -> None:
    segmented = SegmentedObject(what, _odd_objects()[what])
    for hybrid in (None, HybridSettings()):
        found = Arti4UrdfPredictor(tiny_model, hybrid=hybrid).predict(segmented)
        assert found.tree is not None
        assert len(found.tree.links) >= len(segmented.parts)


@pytest.mark.parametrize("hybrid", [None, HybridSettings()])
def test_what_a_confidence_is_made_of(tiny_model: ArtiModel, hybrid: HybridSettings | None) -> None:
    predictor = Arti4UrdfPredictor(tiny_model, hybrid=hybrid)
    segmented = _parts("StorageFurniture", 1)
    found, known = predictor.predict_with_evidence(segmented)
    assert set(known) == set(found.confidence) == set(found.notes)
    confidence_model = load_confidence("arti4urdf" if hybrid is None else "hybrid")
    assert all(set(confidence_model.names) <= set(evidence) for evidence in known.values())
    own = {link: confidence_model.confidence(evidence) for link, evidence in known.items()}
    assert found.tree is not None
    assert found.confidence == share_confidence(own, found.tree, segmented.parts)
