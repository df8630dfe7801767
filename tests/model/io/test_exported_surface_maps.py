"""Normal, emissive and occlusion maps: from a GLB through cutting and the saved asset into every
format, read back by other programs."""

import io
import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from pxr import Usd, UsdShade
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from model.core.articulated_object import ArticulatedObject
from model.core.asset import Asset
from model.core.geometry import Material
from model.core.joint import Joint
from model.core.textures import SurfaceMaps
from model.core.tree import KinematicTree
from model.geometry.splitting import Plane, split, split_faces
from model.io.asset_cache import load_asset, save_asset
from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object
from model.io.export.formats import losses_of
from model.io.export.registry import export
from model.io.open_asset import open_asset
from model.scenes.jobs import ASSETS, MJCF
from model.scenes.scene_xml import Stand, write_scene_mjcf
from tests.builders import read_glb, write_glb

FORMATS = ("urdf", "ros", "sdf", "glb", "usd", "mjcf")
GLOW = (1.0, 0.5, 0.25)


def picture(*low_high: tuple[int, int]) -> Image.Image:
    """8 x 8 pixels with values between two bounds in each channel."""
    rng = np.random.default_rng(len(low_high) + low_high[0][0])
    planes = [rng.integers(low, high, (8, 8), dtype=np.uint8) for low, high in low_high]
    return Image.fromarray(np.stack(planes, axis=-1))


PICTURES = {
    "base": picture((0, 255), (0, 255), (0, 255)),
    "normal": picture((108, 148), (108, 148), (245, 255)),
    "emissive": picture((0, 255), (0, 9), (0, 9)),
    "occlusion": picture((100, 255), (0, 9), (0, 9)),
}


def same(image: Image.Image | bytes | str | Path, name: str) -> bool:
    if isinstance(image, (bytes, str, Path)):
        image = Image.open(io.BytesIO(image) if isinstance(image, bytes) else image)
    return np.array_equal(np.asarray(image.convert("RGB")), np.asarray(PICTURES[name]))


def rewritten(path: Path, change: object) -> None:
    """A GLB with another JSON; trimesh writes neither scale nor strength."""
    tree, binary = read_glb(path.read_bytes())
    change(tree)  # type: ignore[operator]
    write_glb(path, tree, binary)


def tree_of(path: Path) -> dict:
    return read_glb(path.read_bytes())[0]


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """A box with all maps."""
    box = trimesh.creation.box((0.4, 0.3, 0.6))
    fields = {"base": "baseColorTexture"} | {k: f"{k}Texture" for k in PICTURES if k != "base"}
    maps = {fields[k]: picture for k, picture in PICTURES.items()}
    plain = {"metallicFactor": 0.25, "roughnessFactor": 0.5, "emissiveFactor": GLOW}
    material = PBRMaterial(name="all", **maps, **plain)
    uv = np.asarray(box.vertices[:, :2] + 0.5 * box.vertices[:, 2:])
    box.visual = TextureVisuals(uv, material=material)
    path = tmp_path_factory.mktemp("source") / "all.glb"
    box.export(path)

    def change(tree: dict) -> None:
        tree["materials"][0]["normalTexture"]["scale"] = 0.5
        tree["materials"][0]["occlusionTexture"]["strength"] = 0.75

    rewritten(path, change)
    return path


@pytest.fixture(scope="module")
def cut(source, tmp_path_factory) -> Asset:
    """The box as the app keeps it, its triangles split by a plane; the upper half is part 1."""
    read = open_asset(source)
    assert read.mesh is not None and read.warnings == ()
    made = split_faces(read.mesh, np.ones(12, bool), [Plane((0, 0, 0.1), (0, 0, 1))])
    upper = made.inside.astype(np.int32)
    assert len(made.mesh.faces) > 12
    save_asset(Asset("all", mesh=made.mesh, element_part=upper), tmp_path_factory.mktemp("w") / "c")
    return load_asset(tmp_path_factory.getbasetemp() / "w0" / "c")


@pytest.fixture(scope="module")
def saved(cut, tmp_path_factory) -> Path:
    parts = split(cut, cut.element_part)
    hinge = Joint("hinge", "revolute", "link_0", "link_1", (0, 0, 1), (0.2, 0.15, 0), 0.0, 1.0)
    obj = ArticulatedObject("all", parts, KinematicTree(("link_0", "link_1"), (hinge,)))
    folder = tmp_path_factory.mktemp("saved") / "all"
    return write_asset(obj, folder, provenance={}, original=cut).folder


@pytest.fixture(scope="module")
def exported(saved, tmp_path_factory) -> dict[str, Path]:
    out = tmp_path_factory.mktemp("out")
    return {name: export(saved, name, out / name)[0] for name in FORMATS}


def check(material: Material) -> None:
    maps = material.maps
    assert maps.normal and maps.emissive and maps.occlusion
    assert same(maps.normal.data, "normal") and same(maps.emissive.data, "emissive")
    assert same(maps.occlusion.data, "occlusion")
    assert (maps.normal_scale, maps.occlusion_strength) == pytest.approx((0.5, 0.75))
    assert maps.emission == pytest.approx(GLOW, abs=1e-5)


def test_they_are_read_kept_and_cut(source, cut):
    check(open_asset(source).mesh.materials[0])
    (material,) = cut.mesh.materials
    check(material)
    # Texture coordinates of cut triangles are where the plane cuts them.
    mesh = cut.mesh
    turned = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1)
    want = turned[:, :2] + 0.5 * turned[:, 2:]
    np.testing.assert_allclose(mesh.uv, want, atol=1e-6)


def test_a_saved_asset_has_them_once(saved):
    for part in load_object(saved).parts:
        check(part.mesh.materials[0])
    pictures = [p for p in (saved / "meshes").iterdir() if p.suffix == ".png"]
    assert len(pictures) == 4


def test_they_survive_a_second_round(exported):
    for name in ("urdf", "ros"):
        check(open_asset(exported[name].parent).mesh.materials[0])
    whole = open_asset(exported["glb"])
    assert whole.warnings == ("ignored: animations (1)",)
    check(whole.mesh.materials[0])


def test_glb(exported):
    scene = trimesh.load(exported["glb"])
    assert len(scene.geometry) == 2
    for geometry in scene.geometry.values():
        material = geometry.visual.material
        for name in ("normal", "emissive", "occlusion"):
            assert same(getattr(material, f"{name}Texture"), name)
        assert same(material.baseColorTexture, "base")
        np.testing.assert_allclose(material.emissiveFactor, GLOW, atol=1e-5)
    tree = tree_of(exported["glb"])
    (material,) = tree["materials"]
    assert material["normalTexture"]["scale"] == pytest.approx(0.5)
    assert material["occlusionTexture"]["strength"] == pytest.approx(0.75)
    assert len(tree["images"]) == len(tree["textures"]) == 4


def test_usd(exported):
    stage = Usd.Stage.Open(str(exported["usd"]))
    visuals = [p for p in stage.Traverse() if p.GetName() == "visual"]
    materials = [UsdShade.MaterialBindingAPI(v).ComputeBoundMaterial()[0] for v in visuals]
    bound = {str(m.GetPath()) for m in materials}
    assert len(visuals) == 2 and len(bound) == 1
    surface = UsdShade.Material(stage.GetPrimAtPath(bound.pop())).ComputeSurfaceSource()[0]
    want = {
        "diffuseColor": ("base", "rgb", "sRGB", None, None),
        "normal": ("normal", "rgb", "raw", (1, 1, 2, 1), (-0.5, -0.5, -1, 0)),
        "emissiveColor": ("emissive", "rgb", "sRGB", (*GLOW, 1), (0, 0, 0, 0)),
        "occlusion": ("occlusion", "r", "raw", (0.75,) * 4, (0.25,) * 4),
    }
    for name, (file, output, space, scale, bias) in want.items():
        source, channel, _ = surface.GetInput(name).GetConnectedSource()
        texture = UsdShade.Shader(source.GetPrim())
        assert texture.GetIdAttr().Get() == "UsdUVTexture" and channel == output
        assert same(texture.GetInput("file").Get().resolvedPath, file)
        assert texture.GetInput("sourceColorSpace").Get() == space
        for key, value in (("scale", scale), ("bias", bias)):
            if value is not None:
                assert tuple(texture.GetInput(key).Get()) == pytest.approx(value, abs=1e-5)
    assert len(list((exported["usd"].parent / "textures").iterdir())) == 4


@pytest.mark.parametrize("name", ["urdf", "sdf"])
def test_mtl(exported, name):
    """Gazebo, whose SDF refers to the same OBJ files, reads norm and map_Ke from an MTL too."""
    meshes = exported[name].parent / "meshes"
    files = set()
    for link in ("base", "link_1"):
        text = (meshes / f"{link}.mtl").read_text()
        found = dict(re.findall(r"^(map_\w+|norm) (.+)$", text, re.M))
        assert found["norm"].startswith("-bm 0.5 ") and found["map_ao"].startswith("-mm 0.25 0.75 ")
        keys = {"map_Kd": "base", "norm": "normal", "map_Ke": "emissive", "map_ao": "occlusion"}
        for key, picture in keys.items():
            file = found[key].split()[-1]
            assert same(meshes / file, picture)
            files.add(file)
        assert re.search(r"^Ke 1 0\.735\d+ 0\.537\d+$", text, re.M)  # sRGB of GLOW
        other = trimesh.load(meshes / f"{link}.obj").visual.material
        assert same(other.image, "base") and other.kwargs["norm"][-1] == found["norm"].split()[-1]
    assert len(files) == 4


def test_mjcf(exported):
    model = mujoco.MjModel.from_xml_path(str(exported["mjcf"]))
    roles = mujoco.mjtTextureRole
    want = {roles.mjTEXROLE_RGB: "base", roles.mjTEXROLE_NORMAL: "normal"}
    want |= {roles.mjTEXROLE_EMISSIVE: "emissive", roles.mjTEXROLE_OCCLUSION: "occlusion"}
    assert model.nmat == 2 and model.ntex == 4
    for material in range(model.nmat):
        for role in range(roles.mjNTEXROLE):
            at = model.mat_texid[material, role]
            assert (at >= 0) == (role in {int(r) for r in want})
        for role, name in want.items():
            at = model.mat_texid[material, int(role)]
            size = model.tex_width[at] * model.tex_height[at] * model.tex_nchannel[at]
            start = model.tex_adr[at]
            pixels = model.tex_data[start : start + size].reshape(8, 8, 3)
            assert same(Image.fromarray(pixels[::-1]), name) or same(Image.fromarray(pixels), name)


def test_a_scene_in_mjcf_has_them_once(exported, tmp_path):
    shutil.copytree(exported["mjcf"].parent, tmp_path / ASSETS / "box" / MJCF)
    stands = [Stand(name, "box", np.eye(4)) for name in ("a", "b")]
    path = write_scene_mjcf("two", stands, tmp_path, "scene.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.ntex == 4 and model.nmat == 2 and (model.mat_texid >= 0).sum() == 8


def test_what_a_format_cannot_hold_is_told(saved):
    obj = load_object(saved)
    for name in ("urdf", "ros", "sdf"):
        assert "map_ao" in losses_of(name, obj)[0]
    assert losses_of("mjcf", obj) == (
        "MJCF has no place for the factor of emissive maps, the scale of normal maps, "
        "the strength of occlusion maps of its materials",
    )
    assert losses_of("glb", obj) == losses_of("usd", obj) == ()


def test_light_without_a_map(tmp_path):
    """A lamp brighter than white; MuJoCo has a share of the colour alone."""
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    material = PBRMaterial(name="lamp", baseColorFactor=[1.0, 0, 0, 1.0], emissiveFactor=[1, 0, 0])
    box.visual = TextureVisuals(material=material)
    box.export(tmp_path / "lamp.glb")

    def change(tree: dict) -> None:
        declared = {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
        tree["materials"][0]["extensions"] = declared
        tree["extensionsUsed"] = list(declared)

    rewritten(tmp_path / "lamp.glb", change)
    read = open_asset(tmp_path / "lamp.glb")
    assert read.warnings == () and read.mesh.materials[0].maps == SurfaceMaps(emission=(4, 0, 0))
    parts = split(read, np.zeros(12, int))
    obj = ArticulatedObject("lamp", parts, KinematicTree(("link_0",)))
    saved = write_asset(obj, tmp_path / "a", provenance={}).folder
    paths = {name: export(saved, name, tmp_path / name)[0] for name in ("glb", "usd", "mjcf")}
    (material,) = tree_of(paths["glb"])["materials"]
    assert material["emissiveFactor"] == [1, 0, 0]
    strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    assert strength == pytest.approx(4.0, rel=1e-4)
    assert "KHR_materials_emissive_strength" in tree_of(paths["glb"])["extensionsUsed"]
    stage = Usd.Stage.Open(str(paths["usd"]))
    glow = next(p for p in stage.Traverse() if p.GetName() == "surface")
    assert glow.GetAttribute("inputs:emissiveColor").Get()[0] == pytest.approx(4.0, rel=1e-4)
    assert mujoco.MjModel.from_xml_path(str(paths["mjcf"])).mat_emission[0] == 1.0
    assert "light of another colour" in losses_of("mjcf", load_object(saved))[0]
