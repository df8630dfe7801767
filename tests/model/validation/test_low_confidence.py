"""Joints that the predictor itself doesn't believe."""

from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.validation.examine import with_low_confidence
from model.validation.report import Finding, JointReport, Severity, ValidationReport

DRAWER = Joint("drawer", "prismatic", "link_0", "link_1", (1, 0, 0), lower=0.0, upper=0.7)
WHEEL = Joint("wheel", "continuous", "link_0", "link_2", (1, 0, 0))
STILL = Joint("still", "fixed", "link_0", "link_3")
TREE = KinematicTree(("link_0", "link_1", "link_2", "link_3"), (DRAWER, WHEEL, STILL))
HIT = Finding("collision", Severity.WARNING, "Penetrates base by 3 mm.", 0.003)
ANSWER = ValidationReport(
    (JointReport("wheel", "link_2", (HIT,)), JointReport("drawer", "link_1")), 1.0
)


def test_what_is_likely_wrong_is_to_be_looked_at() -> None:
    assert with_low_confidence(ANSWER, TREE, {"link_1": 0.9, "link_2": 0.5}) is ANSWER
    told = with_low_confidence(ANSWER, TREE, {"link_1": 0.02, "link_2": 0.4, "link_3": 0.3})
    assert [j.joint for j in told.joints] == ["wheel", "drawer", "still"]
    assert {j.severity for j in told.joints} == {Severity.WARNING}
    drawer, wheel, still = (told.of(n) for n in ("drawer", "wheel", "still"))
    assert drawer and wheel and still
    assert drawer.message == "Low confidence (2 %)."
    assert drawer.worst and drawer.worst.q == {"drawer": 0.7}  # shown where it goes
    assert [f.kind for f in wheel.findings] == ["collision", "unsure"]
    assert still.message == "Low confidence (30 %)."
    assert still.worst and not still.worst.q


def test_what_is_broken_stays_so() -> None:
    jammed = Finding("jammed", Severity.ERROR, "Blocked at rest by base.")
    report = ValidationReport((JointReport("drawer", "link_1", (jammed,)),), 1.0)
    told = with_low_confidence(report, TREE, {"link_1": 0.02}).of("drawer")
    assert told is not None
    assert (told.severity, told.message) == (Severity.ERROR, jammed.message)
