"""A scene on a real workbench with its worker processes: what becomes of its objects."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from app.cli.main import parse
from app.cli.serve import make_config
from app.server import part_tasks, scene_tasks, tasks
from app.server.accepting import accept
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.job import Job
from app.server.scene_state import Row, order
from app.server.scene_workspace import SceneWorkspace
from app.viewer.steps.scene_selection import remarks_of
from model.core.errors import CommandError
from model.io.assets.reader import load_object
from model.io.open_asset import open_asset
from model.scenes.asset_parts import asset_digest
from model.validation.report import Finding, JointReport, Severity, ValidationReport
from sessions import commands as cmd
from sessions.scene_commands import DecideObjects
from sessions.storage import AssetStorage
from sessions.store import Store
from tests.builders import native_entry, wait_until
from tests.model.scenes.chat_server import chat_server
from tests.model.scenes.saved import points_in_place
from tests.model.scenes.scenes_made import POSITION, make_assets, own, write_scan, write_scene

EVIL = "rock <script>alert(1)</script>"


def entry(id: str, asset: str | None, x: float, description: str, **more: Any) -> dict[str, Any]:
    turned = {"quaternion_wxyz": [0.8, 0.0, 0.0, 0.6], "description": description, "asset": asset}
    return native_entry(id, x, **turned, **more)


OBJECTS = [
    entry("first", "cab", 0.0, "cabinet"),
    entry("twin", "cab", 1.5, "cabinet"),
    entry("small", "cab", 3.0, "cabinet", scale=[0.5, 0.6, 0.7]),
    entry(EVIL, "rock", 4.5, "rock"),
    entry("lost", "nowhere", 6.0, "cabinet"),
    entry("bad", "broken", 7.5, "cabinet"),
    entry("slab", None, 1.0, "floor", box=[8.0, 3.0, 0.1]),
]


class World:
    """A folder with a scene, and the desks that are opened on it one after the other."""

    def __init__(self, folder: Path, scene: Path | None = None) -> None:
        self.folder = folder
        self.assets = make_assets(folder / "assets")
        (self.assets / "broken.glb").write_bytes(b"no glTF at all")
        self.scene = scene or write_scene(folder / "home.json", own(OBJECTS))
        self.app_state: AppState | None = None
        self.open()

    def having(self, *names: str) -> tuple[Any, ...]:
        """The scene's workspace and the work on some of its objects."""
        works = [self.scene_workspace.work(name) for name in names]
        assert None not in works
        return self.scene_workspace, *works

    def open(self) -> SceneWorkspace:
        workspace = self.folder / "workspace"
        config = ServeConfig(workspace=workspace, predictor="geometric", scene=self.scene)
        self.app_state = AppState(config, Store(workspace), [])
        self.scene_workspace = self.app_state.open_scene(self.scene, (self.assets,))
        wait_until(
            lambda: self.scene_workspace.scene is not None or self.scene_workspace.problem,
            "the scene is read",
        )
        assert self.scene_workspace.problem is None
        self.settle()
        return self.scene_workspace

    def settle(self) -> None:
        scene = self.scene_workspace

        def rests() -> bool:
            trees = [(w, w.document.tree) for w in scene.wanted()]
            return not scene.busy and all(w.drawn if tree else w.prepared for w, tree in trees)

        wait_until(rests, "nothing is left to do")

    def close(self) -> None:
        assert self.app_state is not None
        self.app_state.close()
        self.app_state.store.close()


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    world = World(tmp_path_factory.mktemp("scene"))
    yield world
    world.close()


@pytest.fixture(scope="module")
def accepted(world: World) -> World:
    """The decision is on disk, the server dies at once: the next one carries it out."""
    scene_workspace = world.scene_workspace
    wait_until(lambda: scene_workspace.work("first") is not None, "the first is predicted")
    first = scene_workspace.work("first")
    assert first is not None
    world.close()
    store = Store(world.folder / "workspace")
    record = store.open_object(world.scene, None, "home")
    store.append(record.id, DecideObjects("accept", (first.id,), above=0.1), "ann", record.seq)
    store.close()
    scene_workspace = world.open()
    wait_until(lambda: not scene_workspace.accepting.waiting, "it is carried out")
    return world


def statuses(scene_workspace: SceneWorkspace) -> dict[str, str]:
    return {r.id: r.status for r in scene_workspace.rows()}


def test_objects_are_predicted_once_for_all_their_twins(world: World) -> None:
    scene_workspace, twins = world.scene_workspace, world.scene_workspace.twins
    now = dict.fromkeys(("first", "twin", "small"), "predicted")
    now |= {EVIL: "static", "lost": "missing", "bad": "failed", "slab": "static"}
    assert statuses(scene_workspace) == now
    assert (twins("first"), twins("small")) == (["first", "twin"], ["small"])
    _, first, twin, small = world.having("first", "twin", "small")
    assert first is twin is not small
    assert "nowhere" in scene_workspace.missing_reason(scene_workspace.items["lost"])
    assert "broken.glb" in scene_workspace.missing_reason(scene_workspace.items["bad"])
    work = scene_workspace.work("small")
    assert [w.record.name for w in scene_workspace.works.values()] == ["cab", "cab_2", "broken"]
    assert work is not None and work.document.tree is not None
    kinds = {j.type for j in work.document.tree.joints}
    assert kinds == {"revolute", "prismatic"}
    assert work.document.part_names[1] == "door" and work.document.category == "cabinet"


def test_the_list_of_a_scene_is_a_queue_of_its_objects(world: World) -> None:
    state, scene = world.app_state, world.scene_workspace
    assert state is not None
    gallery, ids = state.gallery, list(scene.items)
    found = gallery.rows({"current": str(ids.index("twin"))})
    assert [r["name"] for r in found["rows"]] == [r.id for r in scene.rows()]
    assert found["states"] == {"predicted": 3, "static": 2, "failed": 1, "missing": 1}
    assert found["rows"][found["at"]]["name"] == "twin"
    predicted = gallery.rows({"state": "predicted", "ids": "1"})["ids"]
    works = {scene.work(ids[i]).id for i in predicted}  # type: ignore[union-attr]
    assert set(gallery.sessions(predicted)) == works and len(works) == 2
    least = min(r.confidence for r in scene.rows() if r.status == "predicted")
    above = gallery.rows({"ids": "1", "above": str(int(100 * least))})
    assert above == {"ids": predicted, "unchecked": []}, "a scene checks what it accepts"
    assert gallery.rows({"ids": "1", "above": "101"})["ids"] == []
    assert [r["name"] for r in gallery.rows({"search": "floor"})["rows"]] == ["slab"]
    assert gallery.thumbnail(ids.index("slab")) is None
    wait_until(lambda: gallery.thumbnail(ids.index("first")), "a predicted object's picture")


def test_the_order_of_a_list_stays_while_somebody_looks_at_it(world: World) -> None:
    """Results that come in change it only once another look begins."""
    state, scene = world.app_state, world.scene_workspace
    assert state is not None

    def look(name: str) -> tuple[list[str], bool]:
        found = state.gallery.rows({"look": name})
        return [r["name"] for r in found["rows"]], found["stale"]

    before = look("page.1")
    assert before == (["first", "twin", "small", *before[0][3:]], False)
    work = scene.work("first")
    assert work is not None
    work.do(cmd.Reject("axis"), "ann")
    assert look("page.1") == (before[0], True), "what was decided keeps its place"
    assert look("page.2") == (["small", "first", "twin", *before[0][3:]], False)
    work.do(cmd.Undo(), "ann")
    assert look("page.1") == (before[0], False)


def test_what_somebody_chooses_is_read_and_predicted_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, str]] = []
    start = SceneWorkspace.start

    def spy(self: Any, kind: str, job: Any, keep: Any, *more: Any, **named: Any) -> None:
        asked.append((kind, more[0][1] if kind == "prepare" else ""))
        start(self, kind, job, keep, *more, **named)

    monkeypatch.setattr(SceneWorkspace, "start", spy)
    world = World(tmp_path)
    try:
        scene = world.scene_workspace
        asked.clear()
        scene.pause(True)
        for work in scene.works.values():
            work.prepared = False
            while work.state.can_undo:
                work.do(cmd.Undo(), "ann")
        scene.prefer("small")
        scene.pause(False)
        world.settle()
        assert next(who for kind, who in asked if kind == "prepare") == "small"
    finally:
        world.close()


def test_a_language_model_decides_where_its_address_is_given(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("openai")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with chat_server() as chat:
        words = ["serve", str(world.scene), "--finder", "openai:m", "--finder-url", chat.url]
        config = make_config(parse(words)[0])
        opened = scene_tasks.read(
            world.scene, (world.assets,), None, config.finder, config.finder_url, tmp_path
        )
        assert chat.requests
    assert opened.items[0].decision.reason == "cabinet seen"


def test_drawn_parts_stand_where_the_object_stands(world: World) -> None:
    scene_workspace = world.scene_workspace
    work, item = scene_workspace.work("small"), scene_workspace.items["small"]
    assert work is not None and work.drawn is not None
    pose = scene_workspace.world_from_copy(item)
    assert pose is not None
    boxes = np.array([s.bounds for s in work.drawn.shapes.values()])
    middle = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
    np.testing.assert_allclose(pose[:3, :3] @ middle + pose[:3, 3], [3.0, 0.5, 0.4], atol=1e-6)
    size = boxes[:, 1].max(0) - boxes[:, 0].min(0)
    np.testing.assert_allclose(size, [0.62 * 0.5, 0.5 * 0.6, 0.8 * 0.7], atol=1e-6)


def test_a_person_decides_what_is_articulable(world: World) -> None:
    scene_workspace = world.scene_workspace
    scene_workspace.set_articulable(EVIL, True, "ann")
    wait_until(lambda: statuses(scene_workspace)[EVIL] == "todo", "the rock is to do")
    work = wait_until(lambda: scene_workspace.work(EVIL), "its working copy")
    wait_until(lambda: work.prepared, "it was looked at")
    assert "cut it by clicks" in work.reason
    scene_workspace.do(cmd.Undo(), "ann")
    assert statuses(scene_workspace)[EVIL] == "static"
    with pytest.raises(CommandError, match="nowhere"):
        scene_workspace.set_articulable("lost", True, "ann")


def test_rejecting_and_taking_it_back(world: World) -> None:
    scene_workspace, small = world.having("small")
    scene_workspace.do(DecideObjects("reject", (small.id,), reason="axis"), "ann")
    assert statuses(scene_workspace)["small"] == "rejected"
    assert small.document.review.reason == "axis" and small.document.review.by == "ann"
    scene_workspace.do(cmd.Undo(), "ann")
    assert statuses(scene_workspace)["small"] == "predicted"
    assert scene_workspace.document.decided == ()


def test_undo_leaves_alone_what_was_accepted_inside_after_a_refusal(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene_workspace, first, small = world.having("first", "small")
    gate = Slow(scene_workspace, monkeypatch)
    scene_workspace.do(DecideObjects("accept", (small.id,)), "ann")
    gate.answer("broken")
    wait_until(lambda: scene_workspace.accepting.refusal(small), "it is held back")
    small.live.do(cmd.Accept(), "ann")  # mended inside, by the same person
    scene_workspace.do(DecideObjects("reject", (first.id,), reason="axis"), "ann")
    assert scene_workspace.undo("ann") == "reject first"
    assert statuses(scene_workspace)["first"] == "predicted"
    assert scene_workspace.undo("ann") == ""  # the refused acceptance is no step
    assert statuses(scene_workspace)["small"] == "accepted"
    small.live.do(cmd.Undo(), "ann")
    world.settle()


def report_of(severity: str) -> ValidationReport:
    """What the gate would say of a door that runs into its cabinet, or of one that is free."""
    message = "Penetrates link_0 by 131 mm at 104°."
    found = () if severity == Severity.OK else (Finding("collision", Severity(severity), message),)
    return ValidationReport((JointReport("door", "link_1", found),), 1.0)


COUNTER = iter(range(1_000_000))


def renew(work: Any) -> None:
    """Give it joints that the gate hasn't seen."""
    joint = next(j for j in work.document.tree.joints if j.moves)
    work.live.do(cmd.SetJoint(replace(joint, upper=0.2 + next(COUNTER) * 1e-5)), "ann")


class Slow:
    """Stands in for the gate in the workers: its answers are given by the test."""

    def __init__(self, scene_workspace: SceneWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[Any] = []
        real = scene_workspace.services.workers.prediction.submit

        def submit(function: Any, *args: Any, **more: Any) -> Any:
            if function is not part_tasks.validate_joints:
                return real(function, *args, **more)
            job: Job[Any] = Job(lambda j: j.end("cancelled"), 0, "", (function, (), {}), None, None)
            self.asked.append(job)
            return job

        monkeypatch.setattr(scene_workspace.services.workers.prediction, "submit", submit)
        for id in ("first", "small"):
            renew(scene_workspace.work(id))

    def answer(self, severity: str) -> None:
        wait_until(lambda: self.asked, "the gate is asked")
        self.asked.pop().end("done", report_of(severity))


def test_what_the_gate_objects_to_waits_for_who_asked(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene_workspace, small = world.having("small")
    gate = Slow(scene_workspace, monkeypatch)
    mine: list[str] = []
    others: list[str] = []
    stop = scene_workspace.watch(lambda: None, lambda title, body, color: others.append(body))

    def shown(id: str) -> str:
        return next(r.shown for r in scene_workspace.rows() if r.id == id)

    def decide(decision: Any, work: Any = small, **more: Any) -> None:
        scene_workspace.do(
            DecideObjects(decision, (work.id,), **more), "ann", lambda *n: mine.append(n[1])
        )

    decide("accept")
    assert shown("small") == "validating" and not any(
        r.id == "small" for r in scene_workspace.rows() if r.undecided
    )
    gate.answer("look")
    wait_until(lambda: mine, "it is told")
    assert mine == [
        "small, door 1: Penetrates link_0 by 131 mm at 104°. Select it again: "
        "Y accepts it anyway, Enter shows it."
    ]
    assert shown("small") == "on_hold" and statuses(scene_workspace)["small"] == "predicted"
    assert scene_workspace.accepting.refusal(small).only_warnings  # type: ignore[union-attr]

    # Undo takes the objection with it, and ends the work at once.
    decide("accept")
    assert shown("small") == "on_hold"
    scene_workspace.do(cmd.Undo(), "ann")
    assert shown("small") == "predicted"
    renew(small)
    decide("accept")
    job = gate.asked[-1]
    scene_workspace.do(cmd.Undo(), "ann")
    wait_until(
        lambda: job.state == "cancelled" and not scene_workspace.accepting.waiting,
        "the gate is stopped",
    )
    assert shown("small") == "predicted"
    gate.asked.clear()

    # Of what was seen, Y accepts it as it is; another one's X is told to whoever waits.
    mine.clear()
    decide("accept", looked=True)
    scene_workspace.do(DecideObjects("reject", (small.id,), reason="axis"), "rob", lambda *n: None)
    wait_until(lambda: mine, "it is told")
    assert (
        mine == ["small, it was rejected meanwhile by rob. Select it again: Enter opens it."]
        and shown("small") == "rejected"
    )
    assert others == []
    scene_workspace.do(cmd.Undo(), "rob")
    scene_workspace.do(cmd.Undo(), "ann")
    gate.answer("fine")
    wait_until(lambda: not scene_workspace.busy, "nothing goes on")

    # Twins are two objects.
    first = scene_workspace.work("first")
    mine.clear()
    decide("accept", first, looked=True)
    gate.answer("look")
    wait_until(lambda: mine, "it is told")
    assert mine == ["2 objects"] and shown("twin") == "accepted"
    assert first is not None and first.document.saved is not None
    told = json.loads((Path(first.document.saved.folder) / "provenance.json").read_text())
    assert (told["gate"]["verdict"], told["gate"]["looked_at"]) == ("look", True)
    assert told["source"]["scene"] == str(scene_workspace.path)
    scene_workspace.do(cmd.Undo(), "ann")
    assert not {"accepted", "rejected"} & set(statuses(scene_workspace).values())
    stop()


def test_what_was_held_back_and_decided_anew_meanwhile_is_told_once(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene_workspace, first, small = world.having("first", "small")
    gate, mine = Slow(scene_workspace, monkeypatch), list[str]()
    both = (small.id, first.id)
    scene_workspace.do(DecideObjects("accept", both), "ann", lambda *n: mine.append(n[1]))
    gate.answer("look")
    wait_until(lambda: scene_workspace.accepting.refusal(small), "it is held back")
    # The other one is still being judged when the first is accepted as it is.
    scene_workspace.do(
        DecideObjects("accept", (small.id,), looked=True), "ann", lambda *n: mine.append(n[1])
    )
    gate.answer("fine")
    wait_until(lambda: mine, "the first decision is told")
    wait_until(lambda: len(mine) == 2, "the second one too")
    assert mine == ["2 objects", "1 object"]
    assert statuses(scene_workspace)["first"] == statuses(scene_workspace)["small"] == "accepted"
    scene_workspace.do(cmd.Undo(), "ann")
    scene_workspace.do(cmd.Undo(), "ann")
    assert statuses(scene_workspace)["first"] == statuses(scene_workspace)["small"] == "predicted"
    world.settle()


def test_what_is_decided_or_named_inside_meanwhile_counts(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene_workspace, small = world.having("small")
    gate, mine = Slow(scene_workspace, monkeypatch), list[str]()
    scene_workspace.do(DecideObjects("accept", (small.id,)), "ann", lambda *n: mine.append(n[1]))
    wait_until(lambda: gate.asked, "the gate is asked")
    small.live.do(cmd.Reject("axis"), "rob")
    wait_until(lambda: mine, "it is told")
    gate.answer("fine")
    assert mine == ["small, it was rejected meanwhile by rob. Select it again: Enter opens it."]
    assert statuses(scene_workspace)["small"] == "rejected"
    small.live.do(cmd.Undo(), "rob")
    scene_workspace.do(cmd.Undo(), "ann")

    mine.clear()
    renew(small)
    name = small.document.part_names[1]
    scene_workspace.do(DecideObjects("accept", (small.id,)), "ann", lambda *n: mine.append(n[1]))
    wait_until(lambda: gate.asked, "the gate is asked")
    small.live.do(cmd.NamePart(1, "flap"), "rob")
    wait_until(lambda: mine and not scene_workspace.accepting.waiting, "it is told")
    assert "small, it was edited meanwhile by rob: decide again." in mine.pop()
    gate.answer("fine")
    scene_workspace.do(DecideObjects("accept", (small.id,)), "ann", lambda *n: mine.append(n[1]))
    wait_until(lambda: mine, "it is told")
    assert mine == ["1 object"] and small.document.saved is not None
    saved = load_object(small.document.saved.folder)
    assert saved.name == "cab_2"  # as the robot is called in every format, without a hash
    assert "flap" in [p.name for p in saved.parts]
    scene_workspace.do(cmd.Undo(), "ann")
    scene_workspace.do(cmd.Undo(), "ann")
    small.live.do(cmd.NamePart(1, name), "rob")
    world.settle()


def test_what_was_asked_for_inside_is_held_back_in_the_scene(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever asked needn't wait there for the gate."""
    scene_workspace, small = world.having("small")
    assert world.app_state is not None
    gate, refused = Slow(scene_workspace, monkeypatch), list[CommandError]()
    obj = world.app_state.object(small.id)
    wait_until(lambda: obj.asset is not None and gate.asked, "it is open, and the gate is asked")
    accept(obj, "the hinge is bent", "ann", refused=refused.append)
    row = scene_workspace.row(small.item)
    assert row.shown == "validating" and not row.undecided
    gate.answer("look")
    wait_until(lambda: refused, "it is told")
    refusal = scene_workspace.accepting.refusal(small)
    assert refusal is not None and refusal.only_warnings
    assert refusal.why == "door 1: Penetrates link_0 by 131 mm at 104°."
    assert (
        scene_workspace.row(small.item).shown == "on_hold"
        and statuses(scene_workspace)["small"] == "predicted"
    )
    assert (
        obj.pending_acceptance is not None and obj.pending_acceptance.comment == "the hinge is bent"
    )
    # Seen there it is accepted as it is, and nothing is held back any more.
    scene_workspace.do(DecideObjects("accept", (small.id,), looked=True), "ann")
    wait_until(lambda: scene_workspace.row(small.item).shown == "accepted", "accepted")
    assert not obj.hold_reason
    scene_workspace.do(cmd.Undo(), "ann")
    world.settle()


def test_what_another_server_decides_is_seen_and_left_to_it(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene_workspace, small = world.having("small")
    assert world.app_state is not None
    monkeypatch.setattr("app.server.app_state.SYNC_SECONDS", 1e6)
    store = Store(world.folder / "workspace")
    app_state = AppState(world.app_state.config, store, [])
    other = app_state.open_scene(world.scene, (world.assets,))
    seen: list[str] = []
    other.watch(lambda: None, lambda *note: seen.append(note[0]))
    wait_until(lambda: other.scene is not None, "the scene is read")
    wait_until(
        lambda: not other.busy and statuses(other) == statuses(scene_workspace),
        "it stands there as here",
    )

    before = small.live.state.seq
    scene_workspace.do(DecideObjects("reject", (small.id,), reason="axis"), "ann")
    app_state.sync_remote()
    assert statuses(other)["small"] == "rejected" and seen == ["Changed elsewhere"]
    assert small.live.state.seq == before + 1  # rejected once
    assert other.undo("rob") == "reject small"
    world.app_state.sync_remote()
    assert statuses(scene_workspace)["small"] == statuses(other)["small"] == "predicted"

    # While one server accepts, the other one neither does it as well nor is overruled.
    gate, mine = Slow(scene_workspace, monkeypatch), list[str]()
    scene_workspace.do(DecideObjects("accept", (small.id,)), "ann", lambda *n: mine.append(n[1]))
    wait_until(lambda: gate.asked, "the gate is asked")
    other.do(DecideObjects("reject", (small.id,), reason="axis"), "rob")
    assert not other.accepting.waiting and "accept" not in other.busy
    gate.answer("fine")
    wait_until(lambda: mine, "it is told")
    assert mine == ["small, it was rejected meanwhile by rob. Select it again: Enter opens it."]
    assert statuses(scene_workspace)["small"] == "rejected" and seen == ["Changed elsewhere"]
    assert other.undo("rob") == "reject small"
    world.app_state.sync_remote()
    scene_workspace.do(cmd.Undo(), "ann")
    assert statuses(scene_workspace)["small"] == "predicted"
    app_state.close()
    store.close()
    world.settle()


def test_undo_while_the_asset_takes_its_place_takes_it_back(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene_workspace, small = world.having("small")
    gate, publish = Slow(scene_workspace, monkeypatch), AssetStorage.publish
    before = scene_workspace.document.decided
    undoing = threading.Thread(target=lambda: scene_workspace.undo("ann"))

    def slow(*given: Any) -> Any:
        undoing.start()
        wait_until(lambda: scene_workspace.document.decided == before, "it is undone")
        time.sleep(0.3)
        return publish(*given)

    monkeypatch.setattr(AssetStorage, "publish", slow)
    scene_workspace.do(DecideObjects("accept", (small.id,)), "ann")
    gate.answer("fine")
    wait_until(
        lambda: undoing.ident and not undoing.is_alive() and not scene_workspace.busy,
        "all is done",
        60,
    )
    assert statuses(scene_workspace)["small"] == "predicted"
    world.settle()


def test_the_end_of_the_review_is_told() -> None:
    def rows(*states: Any) -> list[Row]:
        return [Row(str(k), s, 0.9, k) for k, s in enumerate(states)]

    left = rows("predicted", "todo", "todo", "rejected", "accepted", "static")
    assert order(left) == ["0", "1", "2"]
    held = [replace(left[0], mark="on_hold"), replace(left[0], id="9", mark="validating")]
    assert order(held) == ["0"]
    assert order(rows("rejected", "accepted", "accepted")) == []
    assert remarks_of(left) == "", "the list has the numbers"
    assert remarks_of(rows("missing", "failed", "predicted")) == "⚠ 2 can't be read."
    assert remarks_of([Row("0", "static", 0.9, None)]) == "Extract an object first."
    static = [Row(k, "static", 0.9, None) for k in "ab"]
    assert remarks_of(static) == "No articulable objects."


def test_a_refused_acceptance_is_no_step_after_the_end_of_the_server(accepted: World) -> None:
    """That one was left by the server before the last, and its object was changed since."""
    scene_workspace = accepted.scene_workspace
    first, small = scene_workspace.work("first"), scene_workspace.work("small")
    assert first is not None and small is not None
    accepted.close()
    store = Store(accepted.folder / "workspace")
    scene = store.open_object(accepted.scene, None, "home")
    store.append(scene.id, DecideObjects("accept", (small.id,)), "ann", scene.seq)
    store.append(small.id, cmd.SetCategory("Table"), "ann", small.live.state.seq)
    store.close()
    scene_workspace = accepted.open()
    assert (
        not scene_workspace.accepting.waiting and statuses(scene_workspace)["small"] == "predicted"
    )
    assert scene_workspace.undo("ann") == "accept first"
    assert statuses(scene_workspace)["first"] == "predicted"
    scene_workspace.do(cmd.Redo(), "ann")
    wait_until(
        lambda: not scene_workspace.accepting.waiting and not scene_workspace.busy,
        "it is accepted again",
    )
    assert statuses(scene_workspace)["first"] == "accepted"
    small = scene_workspace.work("small")
    assert small is not None
    small.live.do(cmd.Undo(), "ann")
    accepted.settle()


def test_what_was_decided_survives_the_end_of_the_server(accepted: World) -> None:
    scene_workspace = accepted.scene_workspace
    work = scene_workspace.work("first")
    assert work is not None
    assert not scene_workspace.accepting.why_refused(work), scene_workspace.accepting.why_refused(
        work
    )
    assert statuses(scene_workspace)["first"] == statuses(scene_workspace)["twin"] == "accepted"
    assert work.document.review.by == "ann" and work.document.saved is not None
    told = json.loads((Path(work.document.saved.folder) / "provenance.json").read_text())
    assert told["gate"] and told["review"]["by"] == "ann"
    source = told["source"]
    assert source["path"] == str(accepted.assets / "cab"), "the asset, not its working copy"
    assert source["sha256"] == asset_digest(accepted.assets / "cab")
    assert source["scene"] == str(accepted.scene) and source["objects"] == ["first", "twin"]
    assert (source["asset"], source["scale"]) == ("cab", [1, 1, 1])


def test_the_saved_scene_loads_and_holds_what_was_accepted(accepted: World) -> None:
    mujoco = pytest.importorskip("mujoco")
    world, scene_workspace = accepted, accepted.scene_workspace
    scene_workspace.set_articulable(EVIL, True, "ann")
    small = scene_workspace.work("small")
    assert small is not None
    scene_workspace.do(DecideObjects("reject", (small.id,), reason="axis"), "bob")
    world.settle()

    def save() -> dict[str, Any]:
        scene_workspace.saving.save(False, "ann")
        wait_until(lambda: scene_workspace.document.saved, "the scene is saved")
        world.settle()
        out = Path(scene_workspace.document.saved.folder)
        return {o["id"]: o for o in json.loads((out / "scene.json").read_text())["objects"]}

    # What is shown as static is saved so, whatever was decided about its twin.
    scene_workspace.set_articulable("twin", False, "ann")
    assert statuses(scene_workspace)["twin"] == save()["twin"]["state"] == "static"
    scene_workspace.set_articulable("twin", True, "ann")
    world.settle()
    said, out = save(), Path(scene_workspace.document.saved.folder)
    now = {"first": "accepted", "twin": "accepted", "small": "rejected", EVIL: "todo"}
    now |= {"lost": "missing", "bad": "failed", "slab": "plain"}
    assert {i: o["state"] for i, o in said.items()} == now
    assert said["first"]["urdf"] and not said["small"]["urdf"]
    assert said["small"]["decided"]["by"] == "bob" and said["small"]["reason"] == "rejected: axis"
    assert said["first"]["decided"]["by"] == "ann" and "cut it by clicks" in said[EVIL]["reason"]
    assert "broken.glb" in said["bad"]["reason"]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["states"]["rejected"] == summary["states"]["todo"] == 1
    told = json.loads((out / "artiworld.json").read_text())
    (first,) = [a for a in told["assets"].values() if a["objects"] == ["first", "twin"]]
    assert (first["source"], first["scene"]) == ("cab", "home.json")
    assert (first["review"]["state"], first["review"]["by"]) == ("accepted", "ann")
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    moving = [model.joint(i).name for i in range(model.njnt)]
    assert len(moving) == 4 and sum(n.startswith("first/") for n in moving) == 2
    solid = {model.geom(i).bodyid[0] for i in range(model.ngeom) if model.geom_contype[i]}
    assert solid == set(range(1, model.nbody))  # every body can be touched
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = data.body("twin/body_0").xpos
    np.testing.assert_allclose(base, [1.5, 0.5, 0.4], atol=0.02)  # its box has a handle in front


def test_an_object_is_picked_out_of_a_room_that_nobody_labelled(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = write_scan(tmp_path / "room.ply")
    (tmp_path / "room_labels.npz").unlink()
    whole = open_asset(path).cloud
    assert whole is not None
    room = World(tmp_path, path)
    scene_workspace, app_state = room.scene_workspace, room.app_state
    assert app_state is not None and statuses(scene_workspace) == {"room": "static"}
    opened: list[int] = []
    scene_workspace.picking.open("room", opened.append)
    obj = app_state.object(wait_until(lambda: opened, "the room is open")[0])
    asset = wait_until(lambda: obj.asset, "its picture")
    # The cabinet stands round made.POSITION; a box round it is what a person would draw.
    world = scene_workspace.world_from_copy(scene_workspace.items["room"])
    points = open_asset(scene_workspace.items["room"].copy).cloud.points  # type: ignore[union-attr, arg-type]
    points = points + world[:3, 3]  # type: ignore[index]
    kept = np.ones(len(points), bool)
    if obj.document.left_out is not None:
        kept[tasks.arrays_of(app_state.workspace).get(obj.document.left_out.elements)] = False
    inside = np.flatnonzero((np.abs(points[kept][:, :2] - POSITION[:2]) < 0.5).all(1))
    ref = tasks.arrays_of(app_state.workspace).put(inside.astype(np.int64))
    obj.do(cmd.AddRegion(1, ref, True, len(inside), "box"), "ann")
    wait_until(lambda: obj.document.segmentation_current and asset is obj.asset, "its parts")
    taken: list[str] = []
    told: list[tuple[str, str, str]] = []
    with pytest.raises(CommandError, match="part 0"):
        scene_workspace.picking.take_out(obj, "room", 0, "cabinet", "ann", taken.append)
    scene_workspace.picking.take_out(obj, "room", 1, "cabinet", "ann", taken.append)
    obj.watch(lambda: None, lambda *said: told.append(said))
    wait_until(lambda: taken == ["cabinet 1"] or told, "it is taken out")
    assert not told
    room.settle()
    assert statuses(scene_workspace) == {"room": "static", "cabinet 1": "todo"}
    scene_workspace.do(cmd.Undo(), "ann")
    assert statuses(scene_workspace) == {"room": "static"}
    scene_workspace.do(cmd.Redo(), "ann")
    room.close()
    scene_workspace = room.open()
    assert statuses(scene_workspace) == {"room": "static", "cabinet 1": "todo"}
    scene_workspace.saving.save(False, "ann")
    saved = wait_until(lambda: scene_workspace.document.saved, "the room is saved")
    room.settle()
    out = Path(saved.folder)
    points = points_in_place(out)
    assert len(points) == len(whole) and KDTree(points).query(whole.points)[0].max() < 1e-6
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    assert model.ngeom and (model.geom_contype[:] > 0).any()
    room.close()


def test_the_report_holds_everything_and_runs_nothing(accepted: World) -> None:
    done: list[Path] = []
    world = accepted
    world.scene_workspace.saving.report(done.append)
    wait_until(lambda: done, "the report")
    page = done[0].read_text(encoding="utf-8")
    assert "<script" not in page and "&lt;script&gt;" in page
    assert "src='http" not in page and page.count("data:image/png;base64") >= 3
    assert "accepted" in page and "ann" in page and "drawer" in page and "nowhere" in page
    # A joint is one line: narrow columns broke each of them into three.
    assert ".line{white-space:nowrap}" in page
    lines = re.findall("<span class=line>(.*?)</span>", page)
    assert lines and all(re.fullmatch(r"[^<]+: \w+.*", line) for line in lines)
    assert re.search(r"ann, \d{4}-\d\d-\d\d \d\d:\d\d<", page)


def test_the_report_shows_the_limits_that_were_saved(accepted: World) -> None:
    scene_workspace = accepted.scene_workspace
    work, saved = scene_workspace.work("first"), scene_workspace.document.saved
    assert work is not None and work.document.tree is not None and saved is not None
    joint = next(j for j in work.document.tree.joints if j.rotates)
    path = Path(saved.folder) / "scene.json"
    told = json.loads(path.read_text())
    (entry,) = (o for o in told["objects"] if o["id"] == "first")
    short = {"joint": joint.name, "was": [joint.lower, joint.upper], "limits": [0.0, 0.5]}
    entry["shortened"] = [{**short, "hits": {"upper": "wall <b>"}}]
    path.write_text(json.dumps(told))
    done: list[Path] = []
    scene_workspace.saving.report(done.append)
    wait_until(lambda: done, "the report")
    page = done[0].read_text(encoding="utf-8")
    assert "revolute 0…29°" in page and "by wall &lt;b&gt;" in page
    assert page.count("limited by wall") == 1  # not of its twin
