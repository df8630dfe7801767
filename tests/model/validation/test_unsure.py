"""Joints that the predictor itself doesn't believe."""

from __future__ import annotations

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.validation.low_confidence import with_unsure
from model.validation.report import Finding, GateReport, JointVerdict

DRAWER = Joint("drawer", "prismatic", "link_0", "link_1", (1, 0, 0), lower=0.0, upper=0.7)
WHEEL = Joint("wheel", "continuous", "link_0", "link_2", (1, 0, 0))
STILL = Joint("still", "fixed", "link_0", "link_3")
TREE = KinematicTree(("link_0", "link_1", "link_2", "link_3"), (DRAWER, WHEEL, STILL))
HIT = Finding("collision", "look", "Runs 3 mm into base.", 0.003)
ANSWER = GateReport(
    (JointVerdict("wheel", "link_2", (HIT,)), JointVerdict("drawer", "link_1")), 1.0
)


def test_what_is_likely_wrong_is_to_be_looked_at() -> None:
    assert with_unsure(ANSWER, TREE, {"link_1": 0.9, "link_2": 0.5}) is ANSWER
    told = with_unsure(ANSWER, TREE, {"link_1": 0.02, "link_2": 0.4, "link_3": 0.3})
    assert [j.joint for j in told.joints] == ["wheel", "drawer", "still"]
    assert {j.verdict for j in told.joints} == {"look"}
    drawer, wheel, still = (told.of(n) for n in ("drawer", "wheel", "still"))
    assert drawer and wheel and still
    assert drawer.sentence == "The prediction is only 2 % sure that it moves so."
    assert drawer.worst and drawer.worst.q == {"drawer": 0.7}  # shown where it goes
    assert [f.kind for f in wheel.findings] == ["collision", "unsure"]
    assert still.sentence == "The prediction is only 30 % sure that it doesn't move."
    assert still.worst and not still.worst.q


def test_what_is_broken_stays_so() -> None:
    jammed = Finding("jammed", "broken", "Can't move from rest.")
    report = GateReport((JointVerdict("drawer", "link_1", (jammed,)),), 1.0)
    told = with_unsure(report, TREE, {"link_1": 0.02}).of("drawer")
    assert told is not None
    assert (told.verdict, told.sentence) == ("broken", jammed.sentence)
