"""Decisions of two people about two objects, in any order, while checks and saving take their time.

Checks, assets and saved scenes are made by hand: their jobs end when a test says so. All else is
real: two servers on one workspace with object storage, a scene with instances, open objects.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from unittest import mock

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from app.server import app_state as app_state_module
from app.server import bulk, part_tasks, scene_saving_tasks
from app.server.accepting import accept
from app.server.api import sessions
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.job import Job
from app.server.open_object import OpenObject
from app.server.scene_state import Work
from app.server.scene_workspace import SceneWorkspace
from model.core.errors import CommandError
from model.validation.report import Finding, JointReport, Severity, ValidationReport
from sessions import commands as cmd
from sessions.document import Document
from sessions.review import TRANSITIONS
from sessions.scene_commands import DecideObjects
from sessions.storage import AssetStorage
from sessions.store import Entry, Store
from tests.builders import native_entry, wait_until
from tests.model.scenes.scenes_made import make_assets, own, write_scene

PEOPLE = ("ann", "rob")
INSIDE = ("edit", "reject", "reopen", "undo", "redo", "submit", "comment")
BESIDE = (cmd.RecordSegmentation, cmd.Saved, cmd.Placed, cmd.AddComment, cmd.ResolveComment)
"""What leaves a decision standing that is under way."""


def entry(id: str, x: float, scale: list[float]) -> dict[str, Any]:
    return native_entry(id, x, asset="cab", scale=scale)


OBJECTS = [entry("first", 0.0, [1, 1, 1]), entry("twin", 1.5, [1, 1, 1])]
OBJECTS += [entry("small", 3.0, [0.5, 0.6, 0.7])]


def report_of(severity: Severity) -> ValidationReport:
    found = () if severity == Severity.OK else (Finding("collision", severity, "It hits."),)
    return ValidationReport((JointReport("door", "link_1", found),), 1.0)


def callbacks_are_done() -> None:
    for _ in range(4):  # one may add another
        reached, last = (
            threading.Event(),
            Job[Any](lambda j: None, 0, "", (int, (), {}), None, None),
        )
        last.end("done")
        last.add_done_callback(lambda _, reached=reached: reached.set())
        assert reached.wait(60)


@dataclass(eq=False)
class Held:
    """A job that ends when the test says so."""

    server: Server
    job: Job[Any]
    function: Any
    args: tuple[Any, ...]

    @property
    def is_check(self) -> bool:
        return self.function is part_tasks.validate_joints

    def end(self, severity: Severity = Severity.OK) -> None:
        value: Any = {"states": {}}
        if self.is_check:
            value = report_of(severity)
        elif self.function is part_tasks.prepare_asset:
            value = self.server.draft(self.args[1])
        self.job.end("done", value)
        callbacks_are_done()


class Server:
    """A server whose checks, drafts and saved scenes are made by hand."""

    held_functions = (part_tasks.validate_joints, part_tasks.prepare_asset)
    held_functions += (scene_saving_tasks.save_scene,)

    def __init__(self, folder: Path) -> None:
        workspace = self.workspace = folder / "workspace"
        self.scene_file, self.assets = folder / "home.json", folder / "assets"
        config = ServeConfig(workspace=workspace, predictor="geometric", scene=self.scene_file)
        self.store = Store(workspace, storage=f"file://{folder}/storage")
        self.app_state = AppState(config, self.store, [])
        self.jobs: list[Held] = []
        self._drafts = folder / f"drafts {time.monotonic_ns()}"
        self._drafts.mkdir()
        workers = self.app_state.workers
        for worker in (workers.prediction, workers.saving, workers.reading):
            self._hold(worker)
        self.scene: SceneWorkspace = self.app_state.open_scene(self.scene_file, (self.assets,))
        self.told: list[str] = []
        self.scene.watch(lambda: None, lambda *note: self.told.append(" ".join(note)))
        wait_until(lambda: self.scene.scene is not None, "the scene is read")
        scene = self.scene
        wait_until(
            lambda: not scene.busy and scene.works and all(w.drawn for w in scene.works.values()),
            "all is predicted and drawn",
        )
        self.works: list[Work] = list(scene.works.values())
        self.opened: list[OpenObject] = []

    def open_objects(self) -> None:
        for work in self.works:
            obj = self.app_state.object(work.id)
            obj.watch(lambda: None, lambda *_: None)
            wait_until(lambda obj=obj: obj.asset is not None, "it is open")
            self.opened.append(obj)
        wait_until(lambda: not any(set(o.busy) - {"check"} for o in self.opened), "it is encoded")

    def _hold(self, worker: Any) -> None:
        real = worker.submit

        def submit(function: Any, *args: Any, **more: Any) -> Any:
            if function not in self.held_functions:
                return real(function, *args, **more)
            held: Job[Any] = Job(
                lambda j: j.end("cancelled"), 0, "", (function, (), {}), None, None
            )
            self.jobs.append(Held(self, held, function, args))
            return held

        worker.submit = submit

    def draft(self, tree: Any) -> Path:
        """An asset as small as one can be, which names its joints."""
        folder = self._drafts / str(time.monotonic_ns())
        folder.mkdir()
        (folder / "joints").write_text(repr(tree))
        (folder / "provenance.json").write_text('{"asset": {"format": 1, "parts": []}}')
        return folder

    @property
    def waiting(self) -> list[Held]:
        callbacks_are_done()
        self.jobs = [j for j in self.jobs if not j.job.done]
        return self.jobs

    def close(self) -> None:
        self.app_state.close()
        self.store.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("fsspec", reason="the extra s3 is not installed")
    folder = tmp_path_factory.mktemp("decisions")
    make_assets(folder / "assets")
    write_scene(folder / "home.json", own(OBJECTS))
    return folder


@pytest.fixture(scope="module")
def servers(folder: Path) -> Iterator[list[Server]]:
    with mock.patch.object(app_state_module, "SYNC_SECONDS", 1e6):
        made = [Server(folder)]
        made.append(Server(folder))
        for server in made:
            server.open_objects()
        yield made
        for server in made:
            server.close()


def standing(server: Server, work: Work) -> dict[str, Any] | None:
    """What the asset in its place says, which the storage must agree with."""
    name = server.store.object(work.id).asset_name
    folder = server.workspace / "assets" / name
    pointer = server.workspace.parent / "storage" / "assets" / name / "current"
    assert folder.is_dir() == pointer.is_file(), "the storage says the same"
    if not folder.is_dir():
        return None
    return {
        **json.loads((folder / "provenance.json").read_text()),
        "joints": (folder / "joints").read_text(),
    }


def check_asset(server: Server, work: Work) -> Document:
    """An asset stands where its object is accepted, of that very acceptance; nothing else."""
    doc = server.store.load(work.id).present
    found = standing(server, work)
    if doc.review.state != "accepted":
        assert found is None, "what isn't accepted has no asset"
    else:
        assert found is not None, "what is accepted has its asset"
        review = found["review"]
        assert (review["state"], review["by"]) == ("accepted", doc.review.by)
        assert review["at"] == doc.review.at and found["joints"] == repr(doc.tree)
    return doc


# --- what was found by hand


@pytest.fixture
def desk(servers: list[Server]) -> Iterator[SimpleNamespace]:
    """The first server, its scene, and the work that two instances share."""
    start_again(servers)
    server = servers[0]
    shared, small = server.works
    mine: list[str] = []
    yield SimpleNamespace(
        server=server,
        other=servers[1],
        scene=server.scene,
        shared=shared,
        small=small,
        mine=mine,
        note=lambda *n: mine.append(": ".join(n[:2])),
    )
    start_again(servers)


def start_again(servers: list[Server]) -> None:
    """Bring everything back to where nobody had decided anything."""
    for server in servers:
        for obj in server.opened:
            obj.validation.withdraw()
            server.app_state.acceptances.end(obj.record.id)
        server.app_state.sync_remote()
        while server.scene.document.decided:
            server.scene.live.do(cmd.Undo(), "nobody")
        finish(server)
        server.told.clear()
    for work in servers[0].works:
        work.live.refresh()
        while work.document.review.state != "predicted" or work.document.edits > base_edits(work):
            work.live.do(cmd.Undo(), "nobody")
    for server in servers:
        server.app_state.sync_remote()
        callbacks_are_done()


def base_edits(work: Work) -> int:
    """Steps up to the prediction."""
    entries = work.live.store.history(work.id)
    steps = [e for e in entries if not isinstance(e.command, BESIDE)]
    return 1 + next(k for k, e in enumerate(steps) if isinstance(e.command, cmd.RecordPrediction))


def finish(*servers: Server) -> None:
    """End all jobs well, also those that follow."""
    while held := [j for server in servers for j in server.waiting]:
        held[0].end()


def reject(scene: SceneWorkspace, work: Work, who: str, notice: Any) -> None:
    scene.do(DecideObjects("reject", (work.id,), reason="axis"), who, notice)


def test_who_rejects_an_instance_that_is_checked_hears_of_both(desk: Any) -> None:
    scene, shared = desk.scene, desk.shared
    scene.do(DecideObjects("accept", (shared.id,)), "ann", desk.note)
    assert [r.shown for r in scene.rows()].count("validating") == 2
    reject(scene, shared, "ann", desk.note)
    finish(desk.server)
    assert desk.mine[0].startswith("Rejected: 2 objects")
    assert "rejected meanwhile by ann" in desk.mine[1] and len(desk.mine) == 2
    assert check_asset(desk.server, shared).review.state == "rejected"
    assert check_asset(desk.server, desk.small).review.state == "predicted"


def test_a_rejection_while_the_asset_takes_its_place_takes_it_back(
    desk: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish, elsewhere = AssetStorage.publish, desk.other.works[0].live

    def slow(*given: Any) -> Any:
        written = publish(*given)
        elsewhere.do(cmd.Reject("axis"), "rob")
        return written

    monkeypatch.setattr(AssetStorage, "publish", slow)
    desk.scene.do(DecideObjects("accept", (desk.shared.id,)), "ann", desk.note)
    finish(desk.server)
    assert len(desk.mine) == 1 and "rejected meanwhile by rob" in desk.mine[0]
    assert check_asset(desk.server, desk.shared).review.state == "rejected"
    # The same of an open object.
    refused: list[CommandError] = []
    elsewhere.do(cmd.Undo(), "rob")
    desk.server.app_state.sync_remote()
    accept(desk.server.opened[0], "", "ann", refused=refused.append)
    finish(desk.server)
    wait_until(lambda: refused, "it is told", 30)
    assert "rejected meanwhile by rob" in str(refused[0])
    assert check_asset(desk.server, desk.shared).review.state == "rejected"


def test_an_acceptance_that_is_withdrawn_takes_its_asset_back_until_it_is_restored(
    desk: Any,
) -> None:
    server, scene, work = desk.server, desk.scene, desk.small
    scene.do(DecideObjects("accept", (work.id,)), "ann", desk.note)
    finish(server)
    assert desk.mine == ["Accepted: 1 object"]
    first = check_asset(server, work)
    assert first.review.state == "accepted"
    for withdraw in (cmd.Reject("axis"), cmd.Reopen(), cmd.Undo()):
        work.live.do(withdraw, "rob")
        assert check_asset(server, work).review.state != "accepted"
        assert server.store.assets.folder(first.saved) is None
        work.live.do(cmd.Redo() if isinstance(withdraw, cmd.Undo) else cmd.Undo(), "rob")
        assert check_asset(server, work) == first
    # An acceptance of other joints, and back past it: each has its own asset.
    work.live.do(cmd.Reopen(), "rob")
    edit(work.live, "rob")
    scene.do(DecideObjects("accept", (work.id,)), "ann", desk.note)
    finish(server)
    second = check_asset(server, work)
    assert second.review.state == "accepted" and second.tree != first.tree
    for _ in range(3):
        work.live.do(cmd.Undo(), "rob")
        check_asset(server, work)
    assert check_asset(server, work) == first
    for _ in range(3):
        work.live.do(cmd.Redo(), "rob")
    assert check_asset(server, work) == second


def test_undone_at_another_server_it_is_not_accepted_after_all(
    desk: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The undo comes between the last look at the scene's decisions and the acceptance."""
    publish, other = AssetStorage.publish, desk.other

    def slow(*given: Any) -> Any:
        other.app_state.sync_remote()
        assert other.scene.undo("rob") == "accept small"
        return publish(*given)

    reject(desk.scene, desk.shared, "ann", desk.note)
    monkeypatch.setattr(AssetStorage, "publish", slow)
    desk.scene.do(DecideObjects("accept", (desk.small.id,)), "ann", desk.note)
    finish(desk.server)
    assert check_asset(desk.server, desk.small).review.state == "predicted"
    assert check_asset(desk.server, desk.shared).review.state == "rejected", "no other is undone"


def test_a_person_is_told_by_whom_and_not_for_another(desk: Any) -> None:
    """One object that is dropped drops no other decision, though they wait in one queue."""
    scene, notes = desk.scene, {who: [] for who in PEOPLE}
    both = DecideObjects("accept", (desk.small.id, desk.shared.id))
    scene.do(both, "ann", lambda *n: notes["ann"].append(n[1]))
    edit(desk.small.live, "rob")
    scene.do(DecideObjects("accept", (desk.small.id,)), "rob", lambda *n: notes["rob"].append(n[1]))
    finish(desk.server)
    assert notes["rob"] == ["1 object"]
    assert notes["ann"][0] == "2 objects" and "edited meanwhile by rob" in notes["ann"][1]
    assert check_asset(desk.server, desk.small).review.by == "rob"


def test_a_scene_is_not_saved_as_it_was_before(desk: Any) -> None:
    server, scene = desk.server, desk.scene
    scene.do(DecideObjects("accept", (desk.small.id,)), "ann", desk.note)
    finish(server)
    before = scene.document.saved
    scene.saving.save(False, "ann")
    reject(scene, desk.small, "rob", desk.note)
    finish(server)
    assert scene.document.saved == before
    assert "small: it was rejected meanwhile by rob. Save the scene again" in server.told[-1]
    scene.saving.save(False, "ann")
    edit(desk.shared.live, "rob")  # which doesn't move in the saved scene
    finish(server)
    assert scene.document.saved != before and server.told[-1].startswith("Saved")


def test_a_submission_that_waits_for_checks_is_of_what_was_there(
    desk: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, id = desk.server.app_state, desk.small.id
    work, answers = desk.small, list[Any]()
    edit(work.live, "rob")
    strict = replace(state.store.project.settings, required=("collision",))
    monkeypatch.setattr(type(state.store.project), "settings", strict)
    person: Any = SimpleNamespace(name="ann", role=None)
    found = {"opened": desk.server.opened[1], "record_of": work.record}
    for name, value in found.items():  # the API serves no objects of scenes
        monkeypatch.setattr(sessions, name, lambda *_, value=value: value)

    def submit() -> None:
        try:
            answers.append(sessions.submit(id, sessions.CommentBody(), person, state))
        except CommandError as error:
            answers.append(str(error))

    for told in ("it was edited meanwhile by rob: decide again", None):
        waits = mock.Mock(wraps=sessions.wait)
        monkeypatch.setattr(sessions, "wait", waits)
        thread = threading.Thread(target=submit)
        thread.start()
        wait_until(lambda waits=waits: waits.called, "it waits for the checks")
        if told:
            work.live.do(cmd.SetCategory("cupboard"), "rob")
        finish(desk.server)
        thread.join(60)
        if told:
            assert answers.pop() == told and work.document.review.state == "predicted"
    assert work.document.review.state == "submitted"


COUNTER = iter(range(1_000_000))


def edit(live: Any, who: str) -> None:
    """Another limit than ever before."""
    joint = next(j for j in live.document.tree.joints if j.moves)
    live.do(cmd.SetJoint(replace(joint, upper=0.2 + next(COUNTER) * 1e-5)), who)


# --- and in any order


@dataclass(frozen=True)
class Point:
    """What the model knows of an object after a command: its state, and where undo leads."""

    state: str = "predicted"
    past: tuple[str, ...] = ()
    future: tuple[str, ...] = ()

    def after(self, command: cmd.Command) -> Point | None:
        """The point after a command; None where it is refused."""
        if isinstance(command, BESIDE):
            return self if not isinstance(command, cmd.AddComment) else self._step(self.state)
        if isinstance(command, cmd.Undo):
            past, future = self.past[:-1], (*self.future, self.state)
            return Point(self.past[-1], past, future) if self.past else None
        if isinstance(command, cmd.Redo):
            past, future = (*self.past, self.state), self.future[:-1]
            return Point(self.future[-1], past, future) if self.future else None
        named = (cmd.Accept, cmd.Reject, cmd.Reopen, cmd.Submit)
        name = type(command).__name__.lower() if isinstance(command, named) else "adjust"
        then = TRANSITIONS[name].get(self.state)  # type: ignore[index, call-overload]
        return None if then is None else self._step(then)

    def _step(self, state: str) -> Point:
        return Point(state, (*self.past, self.state), ())


@dataclass(eq=False)
class Asked:
    """An acceptance that a person asked for.

    Attributes:
        since: number of the last command that the person's server knew.
        notes: what the person was told of it.
        failed: whether the checks called the object broken.
        at: time of the scene's decision, else "".
        undone: whether that was undone.
    """

    who: str
    object: int
    since: int
    notes: list[str]
    at: str = ""
    failed: bool = False
    undone: bool = False
    accepted: int | None = None


def is_broken(server: Server, number: int) -> bool:
    """True if the checks found errors on the present joints."""
    report = server.works[number].validation.report
    return report is not None and report.severity == Severity.ERROR


class Interleaved(RuleBasedStateMachine):
    """Everything that two people do, and the ends of the jobs that it takes."""

    servers: ClassVar[list[Server]] = []
    indices = st.integers(0, 1)
    people = st.sampled_from(PEOPLE)

    def __init__(self) -> None:
        super().__init__()
        start_again(self.servers)
        self.store = self.servers[0].store
        self.ids = [w.id for w in self.servers[0].works]
        self.begun = [self.store.object(i).seq for i in self.ids]
        self.given: list[list[cmd.Command]] = [[], []]
        self.asked: list[Asked] = []
        self.saves: list[tuple[Held, dict[int, tuple[int, str]], int]] = []

    # --- what the model knows

    def log(self, number: int) -> list[Entry]:
        return self.store.history(self.ids[number], after=self.begun[number])

    def point(self, number: int, upto: int | None = None) -> Point:
        """The state that the commands lead to, as the model sees it."""
        point = Point()
        for line in self.log(number):
            if upto is None or line.seq <= upto:
                after = point.after(line.command)
                assert after is not None, f"{line.command} on {point}"
                point = after
        return point

    def moved(self, asked: Asked, upto: int | None = None) -> bool:
        return any(
            line.seq > asked.since
            and (upto is None or line.seq < upto)
            and not isinstance(line.command, BESIDE)
            for line in self.log(asked.object)
        )

    # --- what people do

    def server(self, number: int) -> Server:
        return self.servers[number % len(self.servers)]

    def give(self, server: Server, number: int, command: cmd.Command, who: str) -> None:
        live, before = server.works[number].live, self.point(number)
        known = live.state.seq
        try:
            live.do(command, who)
        except CommandError:
            stale = self.point(number, known).after(command) is None
            assert stale or before.after(command) is None, f"{command} is refused"
        else:
            assert before.after(command) is not None, f"{command} isn't refused"
            self.given[number].append(command)

    @rule(s=indices, who=people, o=indices, what=st.sampled_from(INSIDE))
    def decide_inside(self, s: int, who: str, o: int, what: str) -> None:
        server, point = self.server(s), self.point(o)
        if what == "edit":
            doc = server.works[o].live.document
            assert doc.tree is not None
            joint = next(j for j in doc.tree.joints if j.moves)
            self.give(server, o, cmd.SetJoint(replace(joint, upper=0.2 + next(COUNTER) / 1e5)), who)
        elif (what == "undo" and not point.past) or (what == "redo" and not point.future):
            return  # it would lead to what was before the beginning
        else:
            kinds = {"reopen": cmd.Reopen, "undo": cmd.Undo, "redo": cmd.Redo, "submit": cmd.Submit}
            more = {"reject": cmd.Reject("axis"), "comment": cmd.AddComment("look")}
            command = more[what] if what in more else kinds[what]()
            self.give(server, o, command, who)

    @rule(s=indices, who=people, objects=st.sampled_from(((0,), (1,), (0, 1), (1, 0))))
    def accept_in_scene(self, s: int, who: str, objects: tuple[int, ...]) -> None:
        server, notes = self.server(s), list[str]()
        known = [server.works[o].live.state.seq for o in objects]
        ids = tuple(self.ids[o] for o in objects)
        server.scene.do(
            DecideObjects("accept", ids), who, lambda *n: notes.append(": ".join(n[:2]))
        )
        at = server.scene.document.decided[-1].at
        self.asked += [
            Asked(who, o, k, notes, at, is_broken(server, o))
            for o, k in zip(objects, known, strict=True)
        ]

    @rule(s=indices, who=people, o=indices)
    def reject_in_scene(self, s: int, who: str, o: int) -> None:
        server, before = self.server(s), self.store.object(self.ids[o]).seq
        reject(server.scene, server.works[o], who, lambda *_: None)
        at = server.scene.document.decided[-1].at
        if self.store.object(self.ids[o]).seq > before:
            self.given[o].append(cmd.Reject("axis", decided_at=at))
        else:  # it is rejected already, as far as this server knows
            assert server.works[o].document.review.state == "rejected"

    @rule(s=indices, who=people)
    def undo_in_scene(self, s: int, who: str) -> None:
        """Undo of the scene gives the objects' commands, which must undo that decision alone."""
        server = self.server(s)
        before = {d.at: d for d in server.scene.live.refresh().present.decided}
        heads = [self.store.load(i) for i in self.ids]
        server.scene.undo(who)
        callbacks_are_done()
        gone = before.keys() - {d.at for d in server.scene.document.decided}
        for asked in self.asked:
            asked.undone |= asked.at in gone
        effective = [before[at] for at in gone if self._had_effect(before[at])]
        assert len(effective) <= 1, "one decision is undone at a time"
        for o, head in enumerate(heads):
            new = self.store.history(self.ids[o], after=head.seq)
            review = head.present.review
            if review.decided_at in gone and review.state in ("accepted", "rejected"):
                assert [line.command for line in new] in ([cmd.Undo()], [cmd.Reopen()])
                self.given[o] += [line.command for line in new]
            else:
                assert not new, "no decision but the one that is undone is changed"

    def _had_effect(self, record: Any) -> bool:
        lines = [line.command for o in (0, 1) for line in self.log(o)]
        accepts = [c for c in lines if isinstance(c, cmd.Accept)]
        return record.decision == "reject" or any(c.decided_at == record.at for c in accepts)

    @rule(s=indices, who=people, o=indices)
    def accept_inside(self, s: int, who: str, o: int) -> None:
        obj, notes = self.server(s).opened[o], list[str]()
        if obj.being_accepted:
            return
        asked = Asked(who, o, obj.state.seq, notes)
        try:
            accept(obj, "", who, refused=lambda error: notes.append(str(error)))
        except CommandError as error:
            notes.append(str(error))
            asked.failed = not self.moved(asked)
            point = self.point(o, asked.since)
            broken = obj.validation.report is not None and obj.validation.report.joints
            assert self.moved(asked) or point.after(cmd.Accept()) is None or broken
        self.asked.append(asked)

    @rule(s=indices, who=people, objects=st.sampled_from(((0, 1), (1, 0))))
    def accept_many(self, s: int, who: str, objects: tuple[int, ...]) -> None:
        server, notes = self.server(s), list[str]()
        if server.app_state.bulk.progress is not None or any(
            o.being_accepted for o in server.opened
        ):
            return
        known = {o: server.works[o].live.state.seq for o in objects}
        server.app_state.bulk.accept(
            [self.ids[o] for o in objects], who, lambda *n: notes.append(": ".join(n[:2]))
        )
        self.rest()
        self.asked += [Asked(who, o, known[o], notes, failed=is_broken(server, o)) for o in objects]

    @rule(s=indices, who=people)
    def save_scene(self, s: int, who: str) -> None:
        server = self.server(s)
        if "save" in server.scene.jobs:
            return
        known = {o: w.live.state.seq for o, w in enumerate(server.works)}
        states = {o: (k, self.point(o, k).state) for o, k in known.items()}
        server.scene.saving.save(False, who)
        (held,) = [j for j in server.waiting if j.function is scene_saving_tasks.save_scene]
        self.saves.append((held, states, self.store.object(server.scene.record.id).seq))

    # --- what takes its time

    @rule(s=indices)
    def take_in_what_others_did(self, s: int) -> None:
        self.server(s).app_state.sync_remote()

    @rule(s=indices, which=st.integers(0, 9), broken=st.sampled_from((False, False, False, True)))
    def end_a_job(self, s: int, which: int, broken: bool) -> None:
        server = self.server(s)
        if server.waiting:
            self.end(server.waiting[which % len(server.waiting)], broken)

    def end(self, held: Held, broken: bool = False) -> None:
        server = held.server
        if held.is_check and broken:
            for asked in self.asked:
                folder = server.works[asked.object].item.copy
                asked.failed |= asked.accepted is None and held.args[0].folder.name == folder.name  # type: ignore[union-attr]
        save = next((x for x in self.saves if x[0] is held), None)
        saved = None if save is None else server.scene.document.saved
        held.end(Severity.ERROR if broken else Severity.OK)
        self.rest()
        if save is not None:
            self.saves.remove(save)
            stale = any(self._matters(o, *known) for o, known in save[1].items())
            lines = [[(line.seq, line.command) for line in self.log(o)] for o in (0, 1)]
            assert (server.scene.document.saved == saved) is stale, (save[1], lines)
            assert ("Save the scene again" in server.told[-1]) is stale, server.told

    def _matters(self, number: int, since: int, state: str) -> bool:
        decided = {state, self.point(number).state} & {"accepted", "rejected"}
        return bool(decided) and self.moved(Asked("", number, since, []))

    def rest(self) -> None:
        """Wait until nothing happens but what jobs must end for."""
        callbacks_are_done()
        for server in self.servers:
            work = server.app_state.bulk

            def rests(server: Server = server, work: Any = work) -> bool:
                return work.progress is None or any(o.being_accepted for o in server.opened)

            wait_until(rests, "the work on many objects rests", 30)
        callbacks_are_done()

    # --- what must be true

    @invariant()
    def each_object_is_as_it_was_decided(self) -> None:
        callbacks_are_done()
        current = {d.at for d in self.store.load(self.servers[0].scene.record.id).present.decided}
        for o, work in enumerate(self.servers[0].works):
            lines = [line.command for line in self.log(o)]
            own_lines = [c for c in lines if not isinstance(c, (cmd.Accept, cmd.Saved))]
            assert own_lines == self.given[o], "nothing is decided that nobody decided"
            doc = check_asset(self.servers[0], work)
            assert doc.review.state == self.point(o).state
            steps = [n.command for n in self.log(o) if not isinstance(n.command, BESIDE)]
            if steps and isinstance(steps[-1], cmd.Accept) and steps[-1].decided_at:
                assert steps[-1].decided_at in current, "it was undone"
            for line in self.log(o):
                if isinstance(line.command, cmd.Accept):
                    self._was_asked(o, line)

    def _was_asked(self, number: int, line: Entry) -> None:
        """An acceptance is one that a person asked for, and for this very state."""
        assert isinstance(line.command, cmd.Accept)
        if any(a.accepted == line.seq and a.object == number for a in self.asked):
            return
        for asked in self.asked:
            accepted = (line.who, number, line.command.decided_at)
            same = (asked.who, asked.object, asked.at) == accepted
            if same and asked.accepted is None and not self.moved(asked, line.seq):
                asked.accepted = line.seq
                return
        raise AssertionError(f"nobody asked for {line}")

    def teardown(self) -> None:
        """In the end everybody got what was asked for, or heard why not."""
        try:
            for _ in range(2):
                for server in self.servers:
                    server.app_state.sync_remote()
                while waiting := [j for server in self.servers for j in server.waiting]:
                    self.end(waiting[0])
            self.rest()
            self.each_object_is_as_it_was_decided()
            for asked in self.asked:
                what = f"{asked} in {[(line.seq, line.command) for line in self.log(asked.object)]}"
                reason = asked.failed or asked.undone or self.moved(asked)
                allowed = self.point(asked.object, asked.since).after(cmd.Accept()) is not None
                assert asked.accepted is not None or reason or not allowed, f"lost: {what}"
                assert asked.accepted is not None or wait_until(
                    lambda asked=asked: asked.notes, f"not told: {what}", 20
                )
        finally:
            start_again(self.servers)


@pytest.mark.parametrize("count", [1, 2], ids=["one server", "two servers"])
def test_decisions_in_any_order_are_of_one_object_and_one_state(
    servers: list[Server], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bulk, "POLL_SECONDS", 0.002)
    monkeypatch.setattr(Interleaved, "servers", servers[:count])
    few = settings(max_examples=8, stateful_step_count=20, deadline=None, derandomize=True)
    few = settings(few, database=None, phases=[Phase.generate])
    few = settings(few, suppress_health_check=list(HealthCheck))
    run_state_machine_as_test(Interleaved, settings=few)
