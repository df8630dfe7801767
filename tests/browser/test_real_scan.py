"""The whole path on a real, noisy, one-sided scan of a refrigerator."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model.validation.report import Severity
from tests.browser.browsing import Tab, wait_until


def frontmost(tab: Tab, height: float, across: float) -> np.ndarray:
    """The displayed point nearest to the viewer at a share of the height and of the width."""
    asset = tab.object.asset
    points, front = asset.display_points, np.asarray(asset.front)
    side = np.cross(front, (0.0, 0.0, 1.0))
    low, high = asset.bounds
    z = low[2] + height * (high[2] - low[2])
    s_low, s_high = np.percentile(points @ side, (2, 98))
    s = s_low + across * (s_high - s_low)
    near = (np.abs(points[:, 2] - z) < 0.06) & (np.abs(points @ side - s) < 0.06)
    index = np.flatnonzero(near)
    return points[index[np.argmax(points[index] @ front)]]


def test_a_real_refrigerator_becomes_an_asset(start: Any, open_tab: Any, shared_data: Path) -> None:
    scan = shared_data / "scans" / "scannet" / "scene0011_00_i27_refrigerator.ply"
    if not scan.exists():
        pytest.skip(f"{scan} is not here")
    tab = open_tab(start(scan))
    tab.prompt(frontmost(tab, 0.5, 0.5))
    tab.choose("Part name", "door")
    tab.key("2")
    wait_until(lambda: tab.selection.part == 2, "key 2 chooses part 2")
    tab.prompt(frontmost(tab, 0.93, 0.5))
    tab.choose("Part name", "door")
    wait_until(lambda: tab.document.part_names == {1: "door", 2: "door"}, "both are doors")
    tab.choose("Category", "Refrigerator")
    wait_until(lambda: tab.document.category == "Refrigerator", "the category")
    tab.key("p")
    tree = wait_until(lambda: tab.document.tree, "a kinematic tree")
    assert tree.root == "link_0"
    assert all(j.moves for j in tree.joints)
    wait_until(lambda: tab.selection.step == "Joints", "the joints are shown")
    for joint in tree.joints:
        if joint.type != "revolute":  # what a person would mend
            tab.app.tab.act(lambda child=joint.child: tab.selection.choose_joint(child))
            wait_until(
                lambda child=joint.child: tab.selection.child == child, "the joint is chosen"
            )
            tab.app.tab.act(lambda: tab.app.joints.editor.set_type("revolute"))
    wait_until(lambda: {j.type for j in tab.document.tree.joints} == {"revolute"}, "both swing")
    wait_until(lambda: not tab.object.busy, "sweeps are done")
    tab.wait_seen()
    tab.key("y")
    if wait_until(lambda: tab.object.validation.report, "a verdict").severity == Severity.WARNING:
        obj = tab.object  # it is shown first
        wait_until(lambda: tab.app.review.validation_list.looked_at(obj), "it was shown")
        tab.wait_seen()
        tab.key("y")
    wait_until(lambda: tab.document.review.state == "accepted", "accepted")
    folder = Path(wait_until(lambda: tab.document.saved, "saved").folder)
    names = {p.suffix for p in (folder / "meshes").iterdir()}
    assert ".ply" in names  # the scanned points
    assert names - {".ply"}  # and a surface
    import mujoco

    mujoco.MjModel.from_xml_path(str(folder / "object.urdf"))
