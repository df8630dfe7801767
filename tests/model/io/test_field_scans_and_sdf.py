"""Files as scanners and Gazebo write them are read as they mean it, or say what they left out."""

from pathlib import Path

import numpy as np
import pytest

from model.core.errors import InputFileError
from model.core.geometry import Material, Mesh
from model.geometry.prepare import prepare
from model.io.export.registry import load_exporter, write_object
from model.io.formats.surveys import units_of_keys, units_of_wkt
from model.io.model_files import read_model
from model.io.open_asset import open_asset
from model.physics.simulation_values import plain_physics
from model.scenes.articulable_finders import load_finder
from model.scenes.asset_parts import index_assets, known_parts
from model.scenes.convert import decide
from model.scenes.registry import read_scene
from model.scenes.unpacking import unpack
from tests.model.io.test_exporters import make_object

BOX = np.array([[x, y, z] for x in (0, 0.8) for y in (0, 0.6) for z in (0, 1.2)])
CLOUD = np.concatenate([BOX, np.random.default_rng(0).uniform(0, 1, (200, 3)) * BOX[-1]])
FOOT = 1200 / 3937


def las(path: Path, points: np.ndarray, records: tuple = (), **said: object) -> Path:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=7 if "wkt" in said else 3, version="1.4")
    header.scales = [1e-9 if np.ptp(points, axis=0).max() < 1.5 else 1e-4] * 3
    header.offsets = points.min(0)
    header.global_encoding.wkt = "wkt" in said
    if "wkt" in said:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(str(said.pop("wkt"))))
    if records:
        keys = np.array([1, 1, 0, len(records), *(v for k, c in records for v in (k, 0, 1, c))])
        data = keys.astype("<u2").tobytes()
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, record_data=data))
    file = laspy.LasData(header)
    file.x, file.y, file.z = points.T
    for name, value in said.items():
        setattr(file, name, value)
    file.write(path)
    return path


PROJCS = 'PROJCS["ft",GEOGCS["a",UNIT["degree",0.0174533]],UNIT["US survey foot",{}]]'
COMPOUND = f'COMPD_CS["both",{PROJCS},VERT_CS["h",UNIT["metre",1]]]'
PROJCRS = (
    'COMPOUNDCRS["n",PROJCRS["p",BASEGEOGCRS["b",ANGLEUNIT["degree",0.0174533]],CS[Cartesian,2],'
    'AXIS["e",east,LENGTHUNIT["foot",0.3048]],AXIS["n",north,LENGTHUNIT["foot",0.3048]]],'
    'VERTCRS["v",CS[vertical,1],AXIS["h",up,LENGTHUNIT["metre",1.0]]]]'
)


@pytest.mark.parametrize(
    ("units", "plane", "height", "says"),
    [
        (units_of_keys({1024: 1, 3072: 2249, 3076: 9003, 4099: 9003}, ""), FOOT, FOOT, "US survey"),
        (units_of_keys({1024: 1, 3076: 9001, 4099: 9002}, "UTM|"), 1, 0.3048, "heights in feet"),
        (units_of_keys({1024: 2, 2048: 4326}, ""), None, 1, "longitudes"),
        (units_of_keys({1024: 1, 3072: 25832}, ""), 1, 1, "none stated; coordinate system 'EPSG"),
        (units_of_wkt(PROJCS.format(FOOT)), FOOT, FOOT, "US survey feet"),
        (units_of_wkt(COMPOUND.format(0.3048)), 0.3048, 1, "heights in metres"),
        (units_of_wkt(PROJCRS), 0.3048, 1, "heights in metres"),
        (units_of_wkt('GEOGCS["WGS 84",UNIT["degree",0.0174533]]'), None, 1, "WGS 84"),
        (units_of_wkt("no system"), None, None, None),
    ],
)
def test_units_of_coordinate_systems(units, plane, height, says) -> None:
    if says is None:
        assert units is None
        return
    assert (units.plane, units.height) == (plane, height) and says in units.remark


def test_surveys_come_in_metres_without_what_must_not_be_processed(tmp_path: Path) -> None:
    far = CLOUD / FOOT + [780_000, 2_950_000, 60]
    files = [
        las(tmp_path / "feet.las", far, ((1024, 1), (3076, 9003), (4099, 9003))),
        las(tmp_path / "wkt.las", far, wkt=PROJCS.format(FOOT)),
    ]
    path = las(tmp_path / "degrees.laz", CLOUD + [11, 48, 0], ((1024, 2), (2048, 4326)))
    with pytest.raises(InputFileError, match="longitudes and latitudes"):
        open_asset(path)
    for path in files:
        size = np.ptp(open_asset(path).bounds, axis=0)
        assert size == pytest.approx([0.8, 0.6, 1.2], rel=0.01), path
    noisy = np.concatenate([CLOUD, np.full((9, 3), 9.0) + np.arange(9)[:, None]])
    kinds = np.r_[np.zeros(len(CLOUD)), [7] * 3, [18] * 3, [0] * 3].astype(np.uint8)
    hidden = np.r_[np.zeros(len(CLOUD) + 6), np.ones(3)].astype(bool)
    path = las(tmp_path / "noise.las", noisy, classification=kinds, withheld=hidden)
    asset = open_asset(path)
    assert asset.element_count == len(CLOUD)
    assert "no coordinate system stated" in asset.warnings[0]
    assert asset.warnings[1:] == (
        "3 points flagged as withheld are left out",
        "6 points classified as noise are left out",
    )


def ptx_station(points: np.ndarray, rows: list[str], matrix: np.ndarray) -> str:
    head = [f"{len(points)}", "1", "0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    head += [" ".join(map(str, row)) for row in matrix.T]
    said = [f"{x} {y} {z} {rest}" for (x, y, z), rest in zip(points, rows, strict=True)]
    return "\n".join([*head, *said, ""])


def test_ptx_stations_stand_in_their_poses(tmp_path: Path) -> None:
    pose = np.array([[0, -1, 0, 2], [1, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    local = (BOX - pose[:3, 3]) @ pose[:3, :3]
    seen = np.concatenate([BOX, np.zeros((2, 3))])
    seen[0] += 0.01  # 0 0 0 stands for nothing
    text = ptx_station(seen, ["0.5 200 30 40"] * 10, np.eye(4))
    (tmp_path / "a.ptx").write_text(text + ptx_station(local, ["0.5"] * 8, pose))
    asset = open_asset(tmp_path / "a.ptx")
    assert asset.element_count == 16 and asset.cloud is not None
    np.testing.assert_allclose(asset.bounds, [[0, 0, 0], [0.8, 0.6, 1.2]], atol=1e-6)
    assert asset.cloud.colors is not None and asset.cloud.colors[0].tolist() == [200, 30, 40]
    said = " | ".join(asset.warnings)
    assert "unit: metres" in said and "2 stations" in said
    assert "2 directions in which nothing was seen" in said and "1 of 2 stations without" in said
    assert "intensities are left out" in said


@pytest.mark.parametrize(("head", "attribute"), [(b"COLOR=", 31), (b"VisCAM", 31 | 1 << 15)])
def test_colours_of_binary_stl_are_told(tmp_path: Path, head: bytes, attribute: int) -> None:
    record = np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    faces = np.zeros(4, record)
    faces["v"] = BOX[[[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]]]
    faces["a"] = attribute
    (tmp_path / "a.stl").write_bytes(head.ljust(80) + np.uint32(4).tobytes() + faces.tobytes())
    assert open_asset(tmp_path / "a.stl").warnings == ("colours of STL files are not read",)


LINK = (
    "<link name='{0}'><pose>{1}</pose><visual name='v'><geometry><box><size>1 1 1</size></box>"
    "</geometry>{2}</visual></link>"
)
HINGE = (
    "<joint name='{0}' type='{1}'><parent>{2}</parent><child>{3}</child><axis><xyz>0 0 1</xyz>"
    "<limit>{4}</limit></axis></joint>"
)
RANGE = "<lower>-1</lower><upper>0</upper>"


def sdf(path: Path, body: str) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"<sdf version='1.9'><model name='m'>{body}</model></sdf>")
    return path


DOOR = LINK.format("door", "1 0 0 0 0 0", "")
HUNG = HINGE.format("h", "revolute", "base", "door", RANGE)
BASE = LINK.format("base", "0 0 0 0 0 0", "")


@pytest.mark.parametrize(
    ("body", "place", "notes"),
    [
        (DOOR + HINGE.format("h", "revolute", "world", "door", RANGE), (1, 0, 0), ""),
        (
            f"{BASE}<frame name='f' attached_to='door'><pose>0 2 0 0 0 0</pose></frame>{DOOR}"
            + HINGE.format("h", "revolute", "base", "f", RANGE),
            (1, 2, 0),
            "",
        ),
        (
            f"{BASE}<model name='front'><pose>0 3 0 0 0 0</pose>{DOOR}</model>"
            + HINGE.format("h", "revolute", "base", "front::door", RANGE),
            (1, 3, 0),
            "",
        ),
        (
            f"{BASE}<include><uri>model://lib</uri><name>in</name><pose>5 0 0 0 0 0</pose>"
            "<placement_frame>edge</placement_frame></include>"
            + HINGE.format("h", "revolute", "base", "in::door", RANGE),
            (5, 0, 0),
            "",
        ),
        (
            f"{BASE}<include merge='true'><uri>model://lib</uri><pose>0 4 0 0 0 0</pose></include>"
            f"{HUNG}",
            (1, 4, 0),
            "",
        ),
        (
            f"{BASE}<include><uri>model://gone</uri></include>{DOOR}{HUNG}",
            (1, 0, 0),
            "'model://gone' is left out",
        ),
        (
            f"<static>true</static>{BASE}{DOOR}"
            + HINGE.format("h", "revolute", "base", "door", "<lower>0</lower><upper>1e16</upper>"),
            (1, 0, 0),
            "has one limit alone (0): read as none",
        ),
        (
            BASE + DOOR + HUNG + HINGE.format("g", "gearbox", "base", "door", RANGE),
            (1, 0, 0),
            "gearbox joints are not supported; it was left out",
        ),
    ],
)
def test_models_as_gazebo_composes_them(tmp_path: Path, body: str, place, notes: str) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "model.config").write_text("<model><sdf version='1.9'>m.sdf</sdf></model>")
    lib = sdf(tmp_path / "lib" / "new.sdf", DOOR + "<frame name='edge' attached_to='door'/>")
    versions = "<sdf version='1.4'>old.sdf</sdf><sdf version='1.10'>new.sdf</sdf>"
    lib.with_name("model.config").write_text(f"<model>{versions}</model>")
    sdf(lib.with_name("old.sdf"), BASE)
    model = read_model(sdf(tmp_path / "m" / "m.sdf", body))
    (hinge,) = (j for j in model.tree.joints if j.moves)
    np.testing.assert_allclose(hinge.origin, place, atol=1e-9)
    said = " | ".join(model.notes)
    assert notes in said if notes else not said
    assert ("static: Gazebo moves nothing" in said) == ("<static>" in body)


def test_worlds_hold_models_inline_and_place_others_by_their_frames(tmp_path: Path) -> None:
    sdf(
        tmp_path / "lib" / "model.sdf",
        BASE + DOOR + HUNG + "<frame name='edge' attached_to='door'/>",
    )
    (tmp_path / "lib" / "model.config").write_text("<model><sdf>model.sdf</sdf></model>")
    path = tmp_path / "w.sdf"
    path.write_text(
        "<sdf version='1.9'><world name='w'>"
        f"<model name='cabinet_inline'><pose>2 1 0 0 0 0</pose>{BASE}{DOOR}{HUNG}</model>"
        "<include><uri>model://lib</uri><name>cabinet_b</name><pose>5 0 0 0 0 0</pose>"
        "<placement_frame>edge</placement_frame></include></world></sdf>"
    )
    scene = read_scene(path)
    inside = unpack(scene, tmp_path / "unpacked")
    found = decide(scene, index_assets([tmp_path / "lib"]), load_finder("lexicon"), inside)
    places = {o.obj.id: o.obj.world_from_object[:3, 3].tolist() for o in found}
    assert places == {"cabinet_inline": [2, 1, 0], "cabinet_b": [4, 0, 0]}
    assert all(o.truth and o.decision.articulable for o in found)
    for outcome in found:
        assert outcome.path is not None
        truth = known_parts(outcome.path).truth
        assert truth is not None and [j.type for j in truth.joints if j.moves] == ["revolute"]


def test_one_sided_slides_are_reported(tmp_path: Path) -> None:
    slide = HINGE.format("h", "prismatic", "base", "door", "<upper>0.4</upper>")
    model = read_model(sdf(tmp_path / "m.sdf", BASE + DOOR + slide))
    (joint,) = (j for j in model.tree.joints if j.moves)
    assert (joint.lower, joint.upper) == (0, 0.4)
    assert "has one limit alone (0.4): it slides from 0 to 0.4 m" in " ".join(model.notes)


def test_looks_of_visuals(tmp_path: Path) -> None:
    script = "<material><script><name>Gazebo/Red</name></script></material>"
    looks = "<diffuse>0 0 1 1</diffuse><emissive>0 1 0 1</emissive>"
    clear = f"<material>{looks}</material><transparency>0.6</transparency>"
    body = LINK.format("a", "0 0 0 0 0 0", script) + LINK.format("b", "1 0 0 0 0 0", clear)
    body += HINGE.format("j", "fixed", "a", "b", "")
    model = read_model(sdf(tmp_path / "m.sdf", body))
    looks = [p.mesh.materials[0].base_color for p in model.load().parts if p.mesh is not None]
    assert looks == [Material().base_color, (0, 0, 255, 102)]
    for what in ("the material script 'Gazebo/Red'", "its emissive colour"):
        assert f"{what} is not read" in " ".join(model.notes)


def test_a_link_takes_its_own_submesh(tmp_path: Path) -> None:
    import trimesh

    scene = trimesh.Scene()
    for name, x in (("Body", 0.0), ("Door", 2.0)):
        made = trimesh.creation.box((1, 1, 1))
        made.apply_translation((x, 0, 0))
        scene.add_geometry(made, node_name=name, geom_name=name)
    scene.export(tmp_path / "cab.glb")
    shape = (
        "<link name='{0}'><visual name='v'><geometry><mesh><uri>cab.glb</uri><submesh>"
        "<name>{0}</name>{1}</submesh></mesh></geometry></visual></link>"
    )
    center = "<center>true</center>"
    body = "".join(shape.format(n, center * (n == "Door")) for n in ("Body", "Door", "Lost"))
    body += HINGE.format("h", "fixed", "Body", "Door", "") + HINGE.format(
        "i", "fixed", "Body", "Lost", ""
    )
    body_part, door, lost = read_model(sdf(tmp_path / "m.sdf", body)).load().parts
    for part in (body_part, door):  # the door's box is about its centre
        np.testing.assert_allclose(part.bounds, [[-0.5] * 3, [0.5] * 3], atol=1e-6)
    assert np.ptp(lost.bounds, axis=0).max() > 2 and "no submesh 'Lost'" in " ".join(lost.remarks)


def test_names_of_parts_survive_an_sdf(tmp_path: Path) -> None:
    obj = make_object()
    write_object(obj, load_exporter("sdf"), tmp_path / "a", physics=plain_physics(obj))
    names = open_asset(tmp_path / "a" / "model.sdf").part_names
    assert {"base", "door"} <= set(names)
    assert not any(name.startswith("visual") for name in names)


def test_outliers_do_not_tip_an_object_on_a_floor() -> None:
    from model.core.asset import Asset
    from model.core.geometry import PointCloud
    from model.geometry.sampling import sample_surface

    rng = np.random.default_rng(1)
    import trimesh

    box = trimesh.creation.box((0.8, 0.6, 1.2))
    box.apply_translation((0, 0, 0.6))
    cabinet, _ = sample_surface(Mesh(np.asarray(box.vertices), np.asarray(box.faces)), 6000, rng)
    floor = np.column_stack([rng.uniform(-1.2, 1.2, (5000, 2)), np.zeros(5000)])
    far = rng.uniform(-3, 4, (300, 3))
    points = np.concatenate([cabinet.points, floor, far]).astype(np.float32)
    made = prepare(Asset("scan", cloud=PointCloud(points)))
    assert made.levelling.up == pytest.approx((0, 0, 1), abs=0.01)
    assert made.levelling.confidence > 0.8
