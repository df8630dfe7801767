"""Sim-Id and Sim-Us: objects found, and objects that work."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import Mesh, affine
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import write_asset
from model.scenes.asset_parts import known_parts, scaled
from model.scenes.jobs import ANNOTATE, PREDICTED, usability
from tests.app.test_scene_command import convert
from tests.builders import boxes
from tests.model.scenes import scenes_made as made

HINGE = Joint("hinge", "revolute", "link_0", "link_1", (0.0, 0.0, -1.0), (0.3, 0.25, 0.0), 0.0, 1.6)
SLIDE = Joint("slide", "prismatic", "link_0", "link_2", (1.0, 0.0, 0.0), (0, 0, 0), 0.0, 0.4)


def cabinet() -> ArticulatedObject:
    parts = tuple(
        Part(f"link_{i}", mesh, None, name)
        for i, (name, mesh) in enumerate(made.cabinet_parts().items())
    )
    return ArticulatedObject(
        "cabinet", parts, KinematicTree(("link_0", "link_1", "link_2"), (HINGE, SLIDE)), "cabinet"
    )


@pytest.mark.parametrize(
    "factors", [(1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (1.0, 2.0, 0.5), (-1.0, 1.0, 1.0)]
)
def test_an_object_works_where_every_joint_is_right(
    factors: tuple[float, float, float], tmp_path: Path
) -> None:
    truth = cabinet()
    write_asset(truth, tmp_path / "cab", provenance={})
    found = known_parts(tmp_path / "cab")
    assert found.truth is not None
    factor = np.array(factors)
    right = found.truth.moved(affine(np.diag(factor)))
    made_ = ArticulatedObject("cabinet", scaled(found.parts, factor), right)
    assert usability(made_, found, factor, PREDICTED) is True
    assert usability(made_, found, factor, ANNOTATE) is False
    slide = right.by_name["slide"]
    assert slide.upper == pytest.approx(0.4 * abs(factors[0]))
    for wrong in (
        replace(slide, axis=(0.0, 1.0, 0.0)),
        replace(slide, upper=0.1 * abs(factors[0])),
        replace(right.by_name["hinge"], origin=(0.3 * factors[0], -0.25 * factors[1], 0.0)),
    ):
        other = ArticulatedObject("cabinet", made_.parts, right.with_joint(wrong))
        assert usability(other, found, factor, PREDICTED) is False
    assert usability(made_, replace(found, truth=None), factor, PREDICTED) is None


def test_a_mirrored_object_moves_as_its_mirror_picture() -> None:
    whole = cabinet()
    factor = np.array([-2.0, 2.0, 2.0])
    mirror = np.diag([*factor, 1.0])
    parts, tree = scaled(whole.parts, factor), whole.tree.moved(affine(np.diag(factor)))
    for q in ({"hinge": 1.1, "slide": 0.3}, {"hinge": 0.4, "slide": 0.0}):
        posed = whole.tree.pose(q)
        seen = tree.pose({**q, "slide": 2 * q["slide"]})
        for link in tree.links:
            np.testing.assert_allclose(seen[link] @ mirror, mirror @ posed[link], atol=1e-12)
    for part, before in zip(parts, whole.parts, strict=True):
        assert part.mesh is not None and before.mesh is not None
        assert signed_volume(part.mesh) == pytest.approx(8 * signed_volume(before.mesh))


def signed_volume(mesh: Mesh) -> float:
    """Cubic metres; negative where faces look inwards."""
    a, b, c = mesh.triangles.swapaxes(0, 1)
    return float((np.cross(a, b) * c).sum() / 6)


def test_the_summary_tells_both(tmp_path: Path) -> None:
    assets = made.make_assets(tmp_path / "assets")
    write_asset(cabinet(), assets / "moving", provenance={})
    urdf = assets / "moving" / "object.urdf"
    urdf.write_text(urdf.read_text().replace('<axis xyz="1 0 0"', '<axis xyz="2 0 0"'))
    rock = boxes(((0, 0, 0), (0.2, 0.2, 0.2)))
    stone = ArticulatedObject("stone", (Part("link_0", rock),), KinematicTree(("link_0",)))
    write_asset(stone, assets / "stone", provenance={})
    objects = [
        {"instance": name, "retrieved_uid": uid, "position": [3 * i, 0, 0],
         "rotation": [0, 0, 0, 1], "scale_factor": [1, 1, 1]}
        for i, (name, uid) in enumerate(
            [("cabinet_1", "moving"), ("vase_1", "moving"), ("oven_1", "stone"), ("pot", "rock")]
        )
    ]  # fmt: skip
    scene = made.write_scene(tmp_path / "layout.json", made.mesatask(objects))
    summary = convert(scene, assets, tmp_path / "out", "--predictor", "geometric")
    assert summary["sim_id"] == {
        "articulable": 2, "found": 1, "wrongly_found": 1, "unknown": 1, "share": 0.5,
    }  # fmt: skip
    # The cabinet's drawer and door are found by geometry; the vase was never tried.
    assert summary["sim_us"]["articulable"] == 2 and summary["sim_us"]["usable"] <= 1
    notes = {r["id"]: r["notes"] for r in summary["results"]}
    assert ["axis of length 2 was normalised" in n for n in notes["cabinet_1"]] == [True]
    assert notes["pot"] == []
