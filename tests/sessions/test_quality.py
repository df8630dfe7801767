"""Second annotations: chosen by the seed, unmarked, compared, and never released."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals

from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.server import queue_routes
from model.core.errors import StoreError
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object
from model.io.model_files import asset_name
from model.io.open_asset import open_asset
from sessions.command_log import open_database, read_work
from sessions.database import Database
from sessions.quality import (
    choose,
    daily_sample,
    next_name,
    pairs_of,
    plant,
    seconds_in,
    summaries,
    week_of,
)
from sessions.releases import accepted_assets
from sessions.statistics import acts_of
from sessions.store import Store
from tests.accepted import accept, cupboard
from tests.app.run_cli import artiworld, assert_users_mistake


@pytest.fixture
def workspace(tmp_path: Path, store: Store) -> Store:
    for k in range(10):
        path = tmp_path / "scans" / f"oven {k}.ply"
        path.parent.mkdir(exist_ok=True)
        path.write_text("scan")
        if k < 4:
            accept(store, path, cupboard(), day=k)
        else:
            store.open_object(path, None, path.stem)
    return store


@pytest.fixture
def database(workspace: Store) -> Iterator[Database]:
    out = open_database(workspace.workspace)
    yield out
    out.close()


def test_the_seed_decides_and_a_second_run_adds_nothing(
    workspace: Store, database: Database
) -> None:
    new = plant(workspace, database, share=0.3, honeypots=2, seed=7)
    assert [s.kind for s in new].count("honeypot") == 2
    assert [s.kind for s in new].count("double") == 3
    accepted = {r.id for r in workspace.objects() if r.state == "accepted"}
    assert all(s.of in accepted for s in new if s.kind == "honeypot")
    assert len({s.of for s in new}) == 5, "no object is annotated three times"
    assert plant(workspace, database, share=0.3, honeypots=2, seed=7) == []
    assert plant(workspace, database, share=0.3, honeypots=2, seed=8) == []
    assert seconds_in(database) == sorted(new, key=lambda s: s.object)
    with pytest.raises(StoreError, match="too few for 8 honeypots"):
        plant(workspace, database, honeypots=10)
    picks = [choose(range(1000), 100, f"seed {k}") for k in (1, 1, 2)]
    assert picks[0] == picks[1] != picks[2] and len(picks[0]) == 100


def test_nothing_that_an_annotator_gets_says_that_it_is_a_second_one(
    workspace: Store, database: Database, tmp_path: Path
) -> None:
    new = plant(workspace, database, share=0.2, honeypots=1)
    config = ServeConfig(workspace=workspace.workspace)
    state = AppState(config, Store(workspace.workspace), [tmp_path / "scans" / "oven 0.ply"])
    try:
        listed = {r.id: r for r in state.queue.records()}
        assert {s.object for s in new} <= set(listed), "they are queued, as uploads are"
        text = json.dumps(state.gallery.rows({}))
        assert queue_routes(state.gallery)
        for word in ("second", "double", "honeypot", "truth"):
            assert word not in text
        for s in new:
            record, first = listed[s.object], workspace.object(s.of)
            assert (record.state, record.seq) == ("todo", 0)
            assert record.name in ("oven 10", "oven 11", "oven 12"), "the series goes on"
            assert record.path.name == f"{record.name}.ply" and first.name not in str(record.path)
            assert record.path.read_text() == "scan"
            folder = record.path.parent.name
            assert len(folder) == 16 and set(folder) <= set("0123456789abcdef"), "as an upload's"
    finally:
        state.close()


def test_pairs_are_compared_and_the_largest_disagreement_comes_first(
    workspace: Store, database: Database
) -> None:
    new = plant(workspace, database, share=0.4, honeypots=2)
    traps = [s for s in new if s.kind == "honeypot"]
    for k, s in enumerate(traps):
        copy = cupboard(upper=(1.5, 0.6)[k])
        accept(workspace, workspace.object(s.object).path, copy, "ben", day=7 * k)
    pairs, waiting = pairs_of(workspace, seconds_in(database))
    assert [p.second for p in pairs] == [traps[1].object, traps[0].object]
    assert [p.agreement.range_iou for p in pairs if p.agreement] == pytest.approx([0.4, 1.0])
    assert {w.object for w in waiting} == {s.object for s in new if s.kind == "double"}
    means = summaries(pairs)
    assert means["person"]["ben"]["pairs"] == 2 and list(means["person"]) == ["ben"]
    assert means["category"]["Oven"]["range_iou"] == pytest.approx(0.7)
    assert list(means["person and week"]) == ["ben 2026-W10", "ben 2026-W11"]
    assert [week_of(d) for d in ("2027-01-03", "2026-12-31", "")] == ["2026-W53", "2026-W53", ""]
    ids = {s.object for s in seconds_in(database)}
    assert len(accepted_assets(workspace, ids)) == 4, "a release has each object once"


def test_the_commands_queue_measure_and_sample(workspace: Store) -> None:
    folder = workspace.workspace
    done = artiworld("repeat", folder, "--honeypots", "1", "--json")
    (row,) = json.loads(done.stdout)
    accept(workspace, workspace.object(row["object"]).path, cupboard(upper=0.6), "ben")
    said = json.loads(artiworld("stats", folder, "--quality", "--json").stdout)
    assert said["means"]["all"]["all"]["pairs"] == 1 and said["waiting"] == []
    shown = artiworld("stats", folder, "--quality").stdout
    assert "ranges overlap by 40 %" in shown and "1 pairs compared" in shown
    assert "nobody" not in artiworld("stats", folder, "--quality", "--since", "2030-01-01").stdout
    sample = artiworld("stats", folder, "--sample", "3", "--day", "2026-03-02", "--json")
    assert {r["person"] for r in json.loads(sample.stdout)} == {"anna", "ben"}
    released = artiworld("release", folder, "--name", "k", "--json")
    assert json.loads(released.stdout)["agreement"]["range_iou"] == pytest.approx(0.4)
    assert_users_mistake(artiworld("repeat", folder), "--double", "--honeypots")
    assert_users_mistake(artiworld("repeat", folder, "--double", "3"), "share from 0 to 1")
    assert_users_mistake(artiworld("repeat", folder / "x", "--double", "1"), "no workspace")


@pytest.mark.parametrize(
    ("name", "taken", "expected"),
    [
        ("oven_03", ["oven_03", "oven_11", "chair_40"], "oven_12"),
        ("chair", ["chair", "chair_2"], "chair_3"),
        ("7128", ["7128", "7201"], "7202"),
        ("scan 9", ["scan 9"], "scan 10"),
        ("a.b(1", ["a.b(1"], "a.b(2"),
    ],
)
def test_a_name_goes_on_as_its_series_does(name: str, taken: list[str], expected: str) -> None:
    assert next_name(name, taken) == expected


def test_files_beside_the_source_are_found(store: Store, tmp_path: Path) -> None:
    """An OBJ with a texture, a URDF with meshes, and a folder that is called as its object."""
    mesh = trimesh.creation.box((0.4, 0.3, 0.2))
    mesh.visual = TextureVisuals(
        uv=mesh.vertices[:, :2], image=Image.new("RGB", (4, 4), (200, 30, 30))
    )
    (tmp_path / "obj").mkdir()
    mesh.export(tmp_path / "obj" / "box.obj")
    saved = write_asset(cupboard(), tmp_path / "cupboard", provenance={})
    paths = [tmp_path / "obj" / "box.obj", saved.folder, tmp_path / "cupboard" / "object.urdf"]
    for path in paths:
        store.open_object(path, None, asset_name(path))
    database = open_database(store.workspace)
    new = plant(store, database, share=1.0)
    database.close()
    copies = {s.of: store.object(s.object) for s in new}
    box, folder, urdf = (open_asset(copies[k].path) for k in (1, 2, 3))
    assert box.mesh is not None and any(m.texture is not None for m in box.mesh.materials)
    assert [j.type for j in load_object(copies[3].path).tree.joints] == ["revolute"]
    assert folder.mesh is not None and urdf.mesh is not None
    assert {copies[k].name for k in (1, 2, 3)} == {"box_2", "cupboard_2", "cupboard_3"}


def test_a_daily_sample_is_the_same_all_day(workspace: Store) -> None:
    acts = acts_of(read_work(workspace.workspace))
    one = daily_sample(acts, "2026-03-02", 5)
    assert one == daily_sample(list(reversed(acts)), "2026-03-02", 5) == {"anna": (1,)}
    assert daily_sample(acts, "2026-04-01", 5) == {}
