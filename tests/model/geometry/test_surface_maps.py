"""Maps of materials: which are read, how they lie, and what is said of those that can't be used."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from model.core.asset import Asset
from model.core.textures import SurfaceMaps
from model.io.open_asset import open_asset

TRIANGLE = (
    "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nusemtl a\nf 1/1 2/2 3/3\n"
)


def mtl_maps(folder: Path, text: str) -> tuple[SurfaceMaps, tuple[str, ...]]:
    (folder / "m.mtl").write_text(f"newmtl a\n{text}\n")
    (folder / "a.obj").write_text(TRIANGLE)
    asset = open_asset(folder / "a.obj")
    assert asset.mesh is not None
    maps = asset.mesh.materials[0].maps
    assert (asset.mesh.uv is not None) == bool(maps.images)
    return maps, asset.warnings


def test_maps_of_an_mtl(tmp_path: Path, checker: Image.Image) -> None:
    rng = np.random.default_rng(0)
    flat = np.stack([*rng.integers(110, 146, (2, 16, 16)), np.full((16, 16), 255)], axis=-1)
    Image.fromarray(flat.astype(np.uint8)).save(tmp_path / "the normals.png")
    heights = Image.fromarray(rng.integers(0, 255, (16, 16), dtype=np.uint8))
    heights.save(tmp_path / "heights.png")
    checker.save(tmp_path / "glow.png")
    for word in ("norm", "map_Bump", "bump"):
        maps, told = mtl_maps(tmp_path, f"{word} -bm 0.5 the normals.png")
        assert maps.normal is not None and maps.normal_scale == 0.5 and told == ()
        assert maps.normal.data == (tmp_path / "the normals.png").read_bytes()
    maps, told = mtl_maps(tmp_path, "map_Bump heights.png\nbump heights.png")
    assert maps == SurfaceMaps() and told == ("left out of its materials: bump map",)
    maps, told = mtl_maps(tmp_path, "map_Bump heights.png\nnorm the normals.png")
    assert maps.normal is not None and told == ()
    # Exporters write a black Ke beside its map, as they write a black Kd beside a texture.
    for ke, light in (("", 1.0), ("Ke 0 0 0\n", 1.0), ("Ke 0.5 0.5 0.5\n", 0.21404)):
        maps, told = mtl_maps(tmp_path, f"{ke}map_Ke glow.png")
        assert maps.emissive is not None and told == ()
        assert maps.emission == pytest.approx((light,) * 3, abs=1e-5)
    maps, _ = mtl_maps(tmp_path, "map_ao -mm 0.25 0.75 glow.png")
    assert maps.occlusion is not None and maps.occlusion_strength == 0.75
    assert mtl_maps(tmp_path, "Ke 1 0 0")[0] == SurfaceMaps(emission=(1.0, 0.0, 0.0))


def test_a_map_that_cannot_be_used_is_told_and_costs_nothing_else(
    tmp_path: Path, checker: Image.Image
) -> None:
    checker.save(tmp_path / "glow.png")
    whole = (tmp_path / "glow.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    text = "map_Kd glow.png\nnorm cut.png\nKe 1 1 1\nmap_Ke gone.png\nmap_ao glow.png"
    maps, told = mtl_maps(tmp_path, text)
    assert maps.occlusion is not None
    assert replace(maps, occlusion=None) == SurfaceMaps()  # nor does it all glow without its map
    assert len(told) == 2 and "texture cut.png" in told[0] and "'gone.png' is missing" in told[1]


def glb_maps(path: Path, checker: Image.Image, change: Callable[[dict], None]) -> Asset:
    """A box with a texture and maps, its JSON changed."""
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    box = trimesh.creation.box((1, 1, 1))
    turned = checker.rotate(90)
    maps = dict.fromkeys(("normalTexture", "occlusionTexture", "emissiveTexture"), turned)
    material = PBRMaterial(baseColorTexture=checker, emissiveFactor=[1, 1, 1], **maps)
    box.visual = TextureVisuals(np.asarray(box.vertices[:, :2]), material=material)
    box.export(path, tree_postprocessor=lambda tree: (change(tree), tree)[1], unitize_normals=False)
    return open_asset(path)


def test_maps_that_lie_in_another_way_are_left_out(tmp_path: Path, checker: Image.Image) -> None:
    moved = {"extensions": {"KHR_texture_transform": {"scale": [2, 2], "offset": [0.5, 0]}}}

    def apart(tree: dict) -> None:
        tree["materials"][0]["occlusionTexture"]["texCoord"] = 1
        tree["materials"][0]["normalTexture"] |= moved

    asset = glb_maps(tmp_path / "a.glb", checker, apart)
    assert asset.mesh is not None
    maps = asset.mesh.materials[0].maps
    assert maps.emissive is not None and maps.normal is None and maps.occlusion is None
    assert asset.warnings == (
        "left out of its materials: normal map with texture coordinates of its own, "
        "occlusion map with texture coordinates of its own",
    )

    def together(tree: dict) -> None:
        tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] |= moved
        for kind in ("normal", "occlusion", "emissive"):
            tree["materials"][0][f"{kind}Texture"] |= moved

    whole = glb_maps(tmp_path / "b.glb", checker, together)
    assert whole.mesh is not None and whole.warnings == ()
    assert len(whole.mesh.materials[0].maps.images) == 3
    plain, scaled = asset.mesh.uv, whole.mesh.uv
    assert plain is not None and scaled is not None
    np.testing.assert_allclose(np.ptp(scaled, axis=0), 2 * np.ptp(plain, axis=0), atol=1e-5)


def test_a_damaged_map_of_a_glb_is_told(tmp_path: Path, checker: Image.Image) -> None:
    def damage(tree: dict) -> None:
        at = tree["textures"][tree["materials"][0]["normalTexture"]["index"]]["source"]
        tree["images"].append({"bufferView": 0, "mimeType": "image/png"})  # not an image at all
        tree["textures"].append({"source": len(tree["images"]) - 1})
        tree["materials"][0]["normalTexture"]["index"] = len(tree["textures"]) - 1
        assert at >= 0

    asset = glb_maps(tmp_path / "a.glb", checker, damage)
    assert asset.mesh is not None
    (material,) = asset.mesh.materials
    assert material.texture is not None and len(material.maps.images) == 2
    assert len(asset.warnings) == 1 and asset.warnings[0].startswith("normal map not used: image")
