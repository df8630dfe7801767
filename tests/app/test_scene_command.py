"""``artiworld scene``: whole scenes from the command line, killed and taken up again."""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from app.cli.main import main
from model.core.geometry import PointCloud
from model.io.assets.asset_folder import load_object
from model.io.open_asset import open_asset, read_part_files
from model.io.urdf.writer import read_urdf
from model.io.write import write_cloud, write_mesh
from model.scenes.asset_parts import asset_digest
from model.scenes.registry import read_scene
from tests.app.run_cli import answer
from tests.builders import wait_until
from tests.model.scenes import scenes_made as made


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.make_assets(tmp_path_factory.mktemp("assets"))


def table_scene(**more: object) -> dict:
    """Two cabinets of one size and one twice as large, a rock against the first one's door, and an
    object whose asset is nowhere."""
    turn = [0, 0, math.sin(made.YAW / 2), math.cos(made.YAW / 2)]
    side = np.array([math.cos(made.YAW), math.sin(made.YAW), 0])
    first = np.array(made.POSITION)

    def entry(name: str, uid: str, at: np.ndarray, scale: list[float]) -> dict:
        return {"instance": name, "retrieved_uid": uid, "position": at.tolist(),
                "rotation": turn, "scale_factor": scale}  # fmt: skip

    return made.mesatask([
        entry("cabinet_1", "cab", first, [1, 1, 1]),
        entry("cabinet_2", "cab", first + [0, 9, 0], [1, 1, 1]),
        entry("cabinet_3", "cab", first + [9, 0, 0], [2, 2, 2]),
        entry("rock_1", "rock", first + 0.6 * side, [1, 1, 1]),
        entry("teapot_1", "nowhere", first + [20, 0, 0], [1, 1, 1]),
        {**entry("broken_1", "cab", first, [1, 1, 1]), "rotation": [0, 0, 0, 0]},
        entry("broken_2\ud800", "cab", first, [1, math.inf, 1]),
    ])  # fmt: skip


def convert(scene: Path, assets: Path, out: Path, *more: str) -> dict:
    words = ["scene", "convert", str(scene), "--assets", str(assets), "--out", str(out)]
    assert main([*words, "--jobs", "1", "--json", *more]) == 0
    return json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module")
def converted(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    folder = tmp_path_factory.mktemp("table")
    scene = made.write_scene(folder / "layout.json", table_scene())
    return folder / "out", convert(scene, assets, folder / "out")


def objects_of(out: Path) -> dict[str, dict]:
    return {o["id"]: o for o in json.loads((out / "scene.json").read_text())["objects"]}


def world_of(entry: dict) -> tuple[np.ndarray, np.ndarray]:
    from scipy.spatial.transform import Rotation

    w, x, y, z = entry["world_from_urdf"]["quaternion_wxyz"]
    turn = Rotation.from_quat([x, y, z, w]).as_matrix()
    return turn, np.array(entry["world_from_urdf"]["position"])


def test_states_are_reported(converted: tuple[Path, dict]) -> None:
    out, summary = converted
    states = {k: v["state"] for k, v in objects_of(out).items()}
    assert states == {"cabinet_1": "predicted", "cabinet_2": "predicted", "cabinet_3": "predicted",
                      "rock_1": "static", "teapot_1": "missing"}  # fmt: skip
    assert summary["missing_assets"] == ["nowhere"]
    assert [p["object"] for p in summary["problems"]] == ["broken_1", "broken_2\ufffd"]


def test_identical_assets_are_converted_once(converted: tuple[Path, dict]) -> None:
    out, summary = converted
    assert summary["assets_converted"] == 3 and len(list((out / "assets").iterdir())) == 3


def test_articulated_objects_stand_exactly_where_the_rigid_ones_stood(
    converted: tuple[Path, dict], assets: Path
) -> None:
    out, _ = converted
    parts = read_part_files(assets / "cab").parts
    scene = {o.id: o for o in read_scene(out.parent / "layout.json").objects}
    for name, entry in objects_of(out).items():
        if entry["state"] != "predicted":
            continue
        factor = scene[name].scale
        rigid = np.concatenate([p.mesh.vertices for p in parts if p.mesh is not None]) * factor
        middle = (rigid.min(0) + rigid.max(0)) / 2
        pose = scene[name].world_from_object
        expected = (rigid - middle) @ pose[:3, :3].T + pose[:3, 3]
        turn, at = world_of(entry)
        obj = read_urdf(out / entry["urdf"])
        made_ = np.concatenate([p.mesh.vertices for p in obj.parts if p.mesh is not None])
        made_ = made_ @ turn.T + at
        assert np.abs(np.sort(made_, 0) - np.sort(expected, 0)).max() < 1e-6


def test_limits_end_where_the_neighbour_stands(converted: tuple[Path, dict]) -> None:
    out, _ = converted
    entries = objects_of(out)
    change = {c["joint"]: c for c in entries["cabinet_1"]["shortened"]}
    assert change and all("rock_1" in c["hits"].values() for c in change.values())
    obj = read_urdf(out / entries["cabinet_1"]["urdf"])
    free = load_object(out / entries["cabinet_1"]["asset_folder"])
    for name, c in change.items():
        assert obj.tree.by_name[name].upper == pytest.approx(c["limits"][1])
        assert obj.tree.by_name[name].upper < free.tree.by_name[name].upper  # type: ignore[operator]
    # Far from the rock nothing is shortened.
    assert "shortened" not in entries["cabinet_2"] and "shortened" not in entries["cabinet_3"]
    slides = [c for n, c in change.items() if free.tree.by_name[n].type == "prismatic"]
    # The rock's near face is 0.6 - 0.1 - 0.3 + 0.02 m (the door's handle is not the drawer's).
    assert slides and all(c["limits"][1] <= 0.6 - 0.1 - 0.29 + 0.02 for c in slides)


def test_keep_limits(converted: tuple[Path, dict], assets: Path, tmp_path: Path) -> None:
    out, _ = converted
    summary = convert(out.parent / "layout.json", assets, tmp_path / "out", "--keep-limits")
    assert summary["shortened_joints"] == 0


def test_the_source_is_written_back_with_urdfs(converted: tuple[Path, dict]) -> None:
    out, _ = converted
    before, after = (json.loads((f / "layout.json").read_text()) for f in (out.parent, out))
    for old, new in zip(before["objects"], after["objects"], strict=True):
        urdf = new.pop("articulation", None)
        assert old == new
        assert (urdf is not None) == old["instance"].startswith("cabinet")
        assert urdf is None or (out / urdf["urdf"]).is_file()


def test_the_scene_records_its_source(converted: tuple[Path, dict], assets: Path) -> None:
    out, summary = converted
    about = json.loads((out / "artiworld.json").read_text())
    assert (about["format"], about["source"], about["reader"]) == (
        "scene",
        "layout.json",
        "mesatask",
    )
    layout = (out.parent / "layout.json").read_bytes()
    assert about["sha256"] == hashlib.sha256(layout).hexdigest() and "scene.xml" in about["files"]
    assert "artiworld.json" in summary["files"]
    by_object = {id: entry for entry in about["assets"].values() for id in entry["objects"]}
    cabinet = by_object["cabinet_1"]
    assert cabinet["source"] == "cab" and cabinet["predictor"]
    assert cabinet["sha256"] == asset_digest(assets / "cab")
    assert by_object["rock_1"]["source"] == "rock.obj" and "predictor" not in by_object["rock_1"]
    assert any(note.startswith("broken_1: ") for note in about["notes"])
    assert str(assets) not in json.dumps(about), "no paths of this machine"


def test_mujoco_steps_the_scene_for_a_second(converted: tuple[Path, dict]) -> None:
    mujoco = pytest.importorskip("mujoco")
    out, _ = converted
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    names = {model.joint(i).name.split("/")[0] for i in range(model.njnt)}
    assert names == {"cabinet_1", "cabinet_2", "cabinet_3"}
    mujoco.mj_forward(model, data)
    for name, entry in objects_of(out).items():
        if "world_from_urdf" in entry:
            roots = [b for b in range(1, model.nbody) if model.body(b).parentid[0] == 0]
            (root,) = [b for b in roots if model.body(b).name.startswith(f"{name}/")]
            assert np.allclose(data.xpos[root], world_of(entry)[1], atol=1e-9)
    for _ in range(round(1 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()


def test_the_own_scene_reads_back(converted: tuple[Path, dict]) -> None:
    out, _ = converted
    scene = read_scene(out / "scene.json")
    assert scene.reader == "artiworld" and len(scene.objects) == 5


@pytest.mark.parametrize(
    ("file", "value"),
    [
        ("house.json", made.holodeck()),
        ("layout.json", made.internscenes()),
        ("scene.json", made.own()),
        ("cab.txt", made.optiscene()),
    ],
)
def test_other_formats_end_to_end(file: str, value: object, assets: Path, tmp_path: Path) -> None:
    path = made.write_scene(tmp_path / file, value)
    assert convert(path, assets, tmp_path / "out")["states"] == {"predicted": 1}
    (entry,) = objects_of(tmp_path / "out").values()
    turn, at = world_of(entry)
    obj = read_urdf(tmp_path / "out" / entry["urdf"])
    every = np.concatenate([p.mesh.vertices for p in obj.parts if p.mesh is not None])
    # The middle of its box is where every format puts it, turned by the same angle.
    middle = (every.min(0) + every.max(0)) / 2
    assert np.allclose(turn @ middle + at, made.POSITION, atol=1e-6)
    assert np.allclose(turn[:, 0], [math.cos(made.YAW), math.sin(made.YAW), 0], atol=1e-6)
    back = tmp_path / "out" / ("source_scene.json" if file == "scene.json" else file)
    assert "articulation" in back.read_text()


def test_lisdf_is_written_back(assets: Path, tmp_path: Path) -> None:
    text = made.lisdf().replace("<scale>1.0", "<scale>0.5")
    path = made.write_scene(tmp_path / "kitchen.lisdf", text)
    convert(path, assets, tmp_path / "out")
    (obj,) = read_scene(tmp_path / "out" / "kitchen.lisdf").objects
    (before,) = read_scene(path).objects
    assert obj.asset is not None and (tmp_path / "out" / obj.asset).is_file()
    assert np.allclose(obj.scale, 1) and np.allclose(before.scale, 0.5)
    assert np.allclose(obj.world_from_object, before.world_from_object)


def test_mirrored_objects_are_mirrored_with_their_joints(assets: Path, tmp_path: Path) -> None:
    """Both formats, in the files of the source, in SDF, and for the gate."""
    own = made.own([{**made.own()["objects"][0], "scale": [1, -1, 1]}])
    text = made.lisdf().replace("Cabinet/cab/link_0.obj", "Cabinet/cab")
    text = text.replace("<scale>1.0<", "<scale>1 -1 1<")
    rigid = [p.mesh for p in read_part_files(assets / "cab").parts if p.mesh is not None]
    for file, value in (("scene.json", own), ("kitchen.lisdf", text)):
        out = tmp_path / f"out of {file}"
        scene = made.write_scene(tmp_path / file, value)
        summary = convert(scene, assets, out, "--predictor", "geometric", "--formats", "sdf")
        assert summary["states"] == {"predicted": 1}
        (entry,) = objects_of(out).values()
        turn, at = world_of(entry)
        obj = load_object(out / entry["asset_folder"])
        shift = np.zeros(3)
        if file == "scene.json":  # which says where the middle of its box is
            every = np.concatenate([m.vertices for m in rigid]) * [1, -1, 1]
            shift = (every.min(0) + every.max(0)) / 2
        pose = made.world_pose()
        for part, before in zip(obj.parts, rigid, strict=True):
            assert part.mesh is not None
            seen = part.mesh.vertices @ turn.T + at
            wanted = (before.vertices * [1, -1, 1] - shift) @ pose[:3, :3].T + pose[:3, 3]
            # Corners of the same places, in whatever order.
            assert KDTree(wanted).query(seen)[0].max() < 1e-6
            assert KDTree(seen).query(wanted)[0].max() < 1e-6
            # Faces look outwards still.
            a, b, c = part.mesh.triangles.swapaxes(0, 1)
            assert (np.cross(a, b) * c).sum() > 0
        assert main(["check", str(out / entry["asset_folder"])]) == 0
        (again,) = read_scene(out / file if "lisdf" in file else out / "scene.json").objects
        seen = again.world_from_object[:3, :3] * again.scale
        if "lisdf" in file:  # its asset is mirrored already
            seen = seen * [-1, 1, 1]
        np.testing.assert_allclose(seen, pose[:3, :3] * [1, -1, 1], atol=1e-6)


def workers_of(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for task in tasks for word in task.read_text().split()]


def test_a_killed_run_is_resumed(assets: Path, tmp_path: Path) -> None:
    """First one of its workers, then the run itself."""
    objects = [
        {"instance": f"cabinet_{i}", "retrieved_uid": "cab", "position": [3 * i, 0, 0],
         "rotation": [0, 0, 0, 1], "scale_factor": [1 + i / 10] * 3}
        for i in range(8)
    ]  # fmt: skip
    scene = made.write_scene(tmp_path / "layout.json", made.mesatask(objects))
    out = tmp_path / "out"
    words = ["scene", "convert", str(scene), "--assets", str(assets), "--out", str(out)]
    words = [sys.executable, "-m", "app.cli.main", *words, "--jobs", "2"]
    run = subprocess.Popen(words, stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[2])
    done = out / "work" / "assets"

    def recorded() -> dict[str, int]:
        return {p.name: p.stat().st_mtime_ns for p in done.glob("*.json")}

    wait_until(lambda: recorded() or run.poll() is not None, "the first asset")
    os.kill(workers_of(run.pid)[0], signal.SIGKILL)
    first = recorded()
    wait_until(lambda: len(recorded()) > len(first) or run.poll() is not None, "it goes on")
    left = workers_of(run.pid)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    wait_until(lambda: not any(Path(f"/proc/{p}").exists() for p in left), "others end")
    kept = recorded()
    assert first.items() <= kept.items() and len(first) < len(kept) < 8
    assert not (out / "summary.json").exists()
    summary = convert(scene, assets, out)
    assert summary["assets_done_before"] == len(kept)
    assert summary["assets_converted"] == 8 - len(kept)
    assert summary["states"] == {"predicted": 8}
    assert len(recorded()) == 8 and kept.items() <= recorded().items()
    assert not list((out / "assets").glob(".*"))
    again = convert(scene, assets, out)
    assert again["assets_done_before"] == 8


def test_one_bad_asset_never_ends_the_run(tmp_path: Path) -> None:
    folder = made.make_assets(tmp_path / "assets")
    (folder / "bad.obj").write_text("v 1 2 nan\nf 1 2 3\n")
    both = [
        {"instance": f"cabinet_{i}", "retrieved_uid": uid, "position": [3 * i, 0, 0],
         "rotation": [0, 0, 0, 1], "scale_factor": [1, 1, 1]}
        for i, uid in enumerate(("bad", "rock", "cab"))
    ]  # fmt: skip
    scene = made.write_scene(tmp_path / "layout.json", made.mesatask(both))
    convert(scene, folder, tmp_path / "out")
    entries = objects_of(tmp_path / "out")
    assert entries["cabinet_0"]["state"] == "failed" and "bad.obj" in entries["cabinet_0"]["reason"]
    assert entries["cabinet_1"]["state"] == "annotate"
    assert "one connected piece" in entries["cabinet_1"]["reason"]
    assert entries["cabinet_2"]["state"] == "predicted"


def test_clicks_beside_an_asset_cut_it_as_in_the_browser(tmp_path: Path) -> None:
    """Without --assets they are beside the scene, as for serve."""
    mesh = made.boxes(
        ((0.0, 0.0, 0.0), (0.02, 0.5, 0.8)), *(((0.0, 0.0, z), (0.4, 0.5, z + 0.02))
        for z in np.linspace(0, 0.78, 13)), ((0.405, 0.0, 0.0), (0.42, 0.5, 0.8)),
    )  # fmt: skip
    click = {"position": [0.42, 0.2, 0.3], "part": 1}
    prompts = {"parts": [{"id": 1, "name": "door"}], "clicks": [click]}
    objects = []
    for i, name in enumerate(("good", "bad", "still")):
        write_mesh(mesh, tmp_path / f"{name}.ply")  # +z up
        kept = json.dumps(prompts) if name != "bad" else "{"
        (tmp_path / f"{name}.prompts.json").write_text(kept)
        objects.append({
            "id": name, "description": "rock" if name == "still" else "cabinet", "asset": name,
            "position": [2.0 * i, 0, 0.5], "quaternion_wxyz": [0.6, 0, 0, 0.8],
            "scale": [2, 1.5, 1], "anchor": "center",
        })  # fmt: skip
    scene = made.write_scene(tmp_path / "home.json", made.own(objects))
    out = tmp_path / "out"
    assert main(["scene", "convert", str(scene), "--out", str(out), "--jobs", "1", "--json"]) == 0
    states = objects_of(out)
    assert {k: v["state"] for k, v in states.items()} == {
        "good": "predicted", "bad": "failed", "still": "static",
    }  # fmt: skip
    assert "bad.prompts.json" in states["bad"]["reason"]
    door = load_object(out / states["good"]["asset_folder"]).parts[1]
    assert door.name == "door" and door.mesh is not None
    # The panel alone, at its size in the scene.
    assert np.allclose(np.sort(np.ptp(door.mesh.vertices, axis=0)), [0.03, 0.75, 0.8], atol=1e-6)
    assert len(door.mesh.faces) == 12


def test_a_scan_stands_on_the_floor_and_not_on_its_outliers(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    top = rng.uniform((-0.3, -0.3, 0.03), (0.3, 0.3, 0.04), (4000, 3))
    outliers = rng.uniform((-0.5, -0.5, -0.4), (0.5, 0.5, -0.1), (6, 3))
    points = np.concatenate([top, outliers]).astype(np.float32)
    write_cloud(PointCloud(points), tmp_path / "slab.ply")
    entry = {"id": "slab", "description": "slab", "asset": "slab", "position": [1, 2, 0],
             "quaternion_wxyz": [1, 0, 0, 0], "scale": [1, 1, 1], "anchor": "base"}  # fmt: skip
    scene = made.write_scene(tmp_path / "room.json", made.own([entry]))
    convert(scene, tmp_path, tmp_path / "out")
    _, at = world_of(objects_of(tmp_path / "out")["slab"])
    np.testing.assert_allclose(at, [1, 2, -0.03], atol=0.005)


def test_inspect(assets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = made.write_scene(tmp_path / "layout.json", table_scene())
    report = answer("scene", "inspect", str(scene), "--assets", str(assets))
    assert [o["articulable"] for o in report["objects"]] == [True, True, True, False, True]
    assert report["missing_assets"] == ["nowhere"]
    assert main(["scene", "inspect", str(scene)]) == 0
    shown = capsys.readouterr().out
    assert "cabinet_1" in shown and "left out" in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere.json"], "nowhere.json"),
        (["layout.json", "--assets", "nowhere"], "nowhere"),
        (["layout.json", "--format", "nonsense"], "nonsense"),
        (["layout.json", "--predictor", "nonsense"], "nonsense"),
        (["layout.json", "--time-limit", "0"], "--time-limit"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    made.write_scene(tmp_path / "layout.json", made.mesatask())
    assert main(["scene", "convert", *words, "--out", "out"]) == 2
    error = capsys.readouterr().err
    assert message in error and len(error.strip().splitlines()) == 1


def test_two_runs_into_one_folder_are_refused(assets: Path, tmp_path: Path) -> None:
    scene = made.write_scene(tmp_path / "layout.json", made.mesatask())
    (tmp_path / "out" / "work").mkdir(parents=True)
    code = (
        "import fcntl, sys, time; f = open(sys.argv[1], 'w'); fcntl.lockf(f, fcntl.LOCK_EX);"
        "print('held', flush=True); time.sleep(600)"
    )
    lock = str(tmp_path / "out" / "work" / "lock")
    holder = subprocess.Popen([sys.executable, "-c", code, lock], stdout=subprocess.PIPE)
    try:
        assert holder.stdout is not None and holder.stdout.readline() == b"held\n"
        words = ["scene", "convert", str(scene), "--assets", str(assets)]
        assert main([*words, "--out", str(tmp_path / "out")]) == 2
    finally:
        holder.kill()
        holder.wait()


def test_a_real_cabinet_in_a_kitchen(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "partnet_mobility"
    rotated = open_asset(folder / "46744")
    text = made.lisdf().replace("Cabinet/cab/link_0.obj", "Cabinet/46744/mobility.urdf")
    scene = made.write_scene(tmp_path / "kitchen.lisdf", text)
    summary = convert(scene, folder / "46744", tmp_path / "out", "--keep-limits")
    assert summary["states"] == {"predicted": 1} and summary["sim_id"]["share"] == 1.0
    (entry,) = objects_of(tmp_path / "out").values()
    obj = read_urdf(tmp_path / "out" / entry["urdf"])
    every = np.stack([p.bounds for p in obj.parts])
    bounds = np.stack([every[:, 0].min(0), every[:, 1].max(0)])
    assert np.abs(bounds - rotated.bounds).max() < 1e-6
    assert np.allclose(world_of(entry)[1], made.POSITION)
