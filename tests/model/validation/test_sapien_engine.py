"""Joints driven in SAPIEN (PhysX on the CPU), beside MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.cli.check import CheckTask, check_one, summary
from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError
from model.core.joint import Joint
from model.evaluation.joint_metrics import ObjectScore, execute
from model.evaluation.report import score_from_json, score_to_json
from model.evaluation.summary import summarise
from model.io.assets.asset_folder import write_asset
from model.physics.collision.build import CollisionSettings
from model.physics.simulation_values import PhysicsSettings, physics_of, rough_physics
from model.validation.engines import ENGINES, STEP, Drive, load_of, require_engines
from model.validation.physics import run_physics
from model.validation.runner import validate
from tests.builders import box, linked, part
from tests.model.validation.cabinets import cabinet, followers, pushed

pytest.importorskip("mujoco")
sapien = pytest.importorskip("sapien")


def test_a_good_cabinet_with_its_shapes_moves_freely():
    said = run_physics(cabinet(), physics_of(cabinet()), engine="sapien")
    wheel = replace(chain().tree.by_name["turn"], type="continuous")
    turning = replace(chain(), tree=chain().tree.with_joint(wheel))
    free = run_physics(turning, engine="sapien")
    assert free.ran and not free.missed and not free.exploded
    assert (said.engine, said.ran, said.problem) == ("SAPIEN", True, "")
    assert said.shapes > 10
    assert not said.exploded and not said.missed and not said.drifted


def chain() -> ArticulatedObject:
    """A slide on a turning arm with a skew axis, each off the origin."""
    return linked(
        (
            Joint("turn", "revolute", "base", "arm", (1, 2, 2), (0.1, 0.2, 0.3), -1.0, 2.0),
            Joint("push", "prismatic", "arm", "slide", (0, 0.6, 0.8), (0.3, 0, 0), 0.0, 0.4),
        ),
        part("base", box([0, 0, 0], [0.1, 0.1, 0.1])),
        part("arm", box([0.1, 0.2, 0.3], [0.5, 0.3, 0.4])),
        part("slide", box([0.3, 0.3, 0.5], [0.4, 0.5, 0.6])),
    )


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_links_stand_where_the_object_says(kind):
    obj = chain()
    turn = replace(obj.tree.by_name["turn"], type=kind)
    obj = replace(obj, tree=obj.tree.with_joint(turn))
    joints = list(obj.tree.joints)
    engine = ENGINES["sapien"].build(obj, joints, rough_physics(obj))
    engine.set_drives([Drive(1.0, 1.0, 0.0)] * 2)
    q = {"turn": 1.3, "push": 0.25}
    engine.rest(np.array([q[j.name] for j in joints]))
    poses = obj.pose(q)
    for link, made in engine.links.items():
        seen = made.entity_pose.to_transformation_matrix()
        at = np.r_[engine.origins[link], 1.0]
        assert seen[:3, 3] == pytest.approx((poses[link] @ at)[:3], abs=1e-5)
        assert seen[:3, :3] == pytest.approx(poses[link][:3, :3], abs=1e-5)


def test_loads_are_those_of_mujoco():
    """So the drives of both engines are equally strong."""
    obj = chain()
    joints, physics = list(obj.tree.joints), rough_physics(obj)
    mujoco = ENGINES["mujoco"].build(obj, joints, physics)
    mujoco.rest(np.zeros(2))
    mujoco.step(np.zeros(2))
    inertias = [load_of(obj, j, physics).inertia for j in joints]
    assert inertias == pytest.approx(mujoco.model.dof_M0, rel=1e-6)
    assert load_of(obj, joints[0], physics).mass == pytest.approx(
        mujoco.model.body_subtreemass[2], rel=1e-6
    )


def test_a_weight_falls_as_far_as_gravity_takes_it():
    obj = chain()
    joint = replace(obj.tree.by_name["push"], axis=(0.0, 0.0, -1.0), upper=5.0)
    obj = replace(obj, tree=obj.tree.with_joint(joint))
    engine = ENGINES["sapien"].build(obj, [joint], rough_physics(obj))
    engine.set_drives([Drive(0.0, 0.0, 0.0)])
    engine.set_gravity(-9.81)
    engine.rest(np.zeros(1))
    for _ in range(100):
        engine.step(np.zeros(1))
    assert engine.q[0] == pytest.approx(0.5 * 9.81 * (100 * STEP) ** 2, rel=0.02)


BLOCKED = pushed(Joint("post", "fixed", "link_0", "link_2"))


def test_what_shapes_block_is_told_with_the_place_and_the_engine():
    made = physics_of(BLOCKED, PhysicsSettings(CollisionSettings("hull")))
    said = run_physics(BLOCKED, made, engine="sapien")
    stop = said.stops["pusher"]
    assert said.missed["pusher"] > 0.5
    assert (stop.other, stop.where[0]) == ("link_2", pytest.approx(0.3, abs=0.01))
    free = run_physics(BLOCKED, replace(made, overlapping=(("link_1", "link_2"),)), engine="sapien")
    assert not free.missed


@pytest.mark.parametrize("engine", ["mujoco", "sapien"])
def test_a_follower_is_judged_where_its_leader_takes_it(engine):
    good = run_physics(followers(0.9), engine=engine)
    assert not good.exploded and not good.missed and not good.drifted
    bad = run_physics(followers(20.0), engine=engine)
    # MuJoCo's couplings hold the leader back; SAPIEN's follower stays behind.
    assert set(bad.missed) == {"a" if engine == "mujoco" else "b"}


def test_check_and_evaluate_name_the_engine_that_refuses(tmp_path):
    good, bad = tmp_path / "good", tmp_path / "bad"
    write_asset(followers(0.9), good, provenance={})
    write_asset(followers(20.0), bad, provenance={})
    engines = ("mujoco", "sapien")
    rows = [
        check_one(CheckTask(folder, folder.name, (), PhysicsSettings(), None, True, 0.0, engines))
        for folder in (good, bad)
    ]
    assert rows[0]["gate"]["engines"] == {"mujoco": True, "sapien": True}
    assert rows[1]["gate"]["engines"] == {"mujoco": False, "sapien": False}
    assert summary(rows)["engines"] == {"mujoco": 1, "sapien": 1}
    said = [f["sentence"] for j in rows[1]["gate"]["joints"] for f in j["findings"]]
    assert any(s.startswith("SAPIEN: ") for s in said)
    assert any(s.startswith("MuJoCo: ") for s in said)
    run = execute(followers(20.0), engines=engines)
    assert (run.executable, run.engines) == (False, {"mujoco": False, "sapien": False})
    score = ObjectScore("x", None, (), execution=run)
    assert score_from_json(score_to_json(score)).execution == run
    assert summarise([score])["executable_sapien"] == 0.0


def test_engines_that_are_not_there_are_refused_by_name(monkeypatch):
    with pytest.raises(ConfigurationError, match="no engine 'bullet'; there are mujoco, sapien"):
        require_engines("mujoco,bullet")
    assert require_engines("sapien, mujoco,sapien") == ("sapien", "mujoco")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"SAPIEN, which isn't installed; .*\[sapien\]"):
        require_engines("sapien")


def test_findings_of_one_engine_count_for_it_alone():
    report = validate(BLOCKED, engines=("mujoco", "sapien"), fixes=False)
    runs = (report.physics, *report.others)
    assert [run.engine for run in runs] == ["MuJoCo", "SAPIEN"]
    found = [f for j in report.joints for f in j.findings if f.engine == "SAPIEN"]
    kept = tuple(
        replace(j, findings=tuple(f for f in j.findings if f.engine == "SAPIEN"))
        for j in report.joints
    )
    alone = replace(report, joints=kept)
    if any(f.severity == "broken" for f in found):
        assert not alone.executable_in(runs[1])
    assert alone.executable_in(runs[0])
