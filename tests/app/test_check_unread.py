"""``artiworld check`` on a folder says for each asset what of its file was not read."""

from __future__ import annotations

import json
from pathlib import Path

from app.cli.main import main

URDF = """<robot name="r"><link name="a"><visual><geometry><box size="1 1 1"/></geometry></visual>
<wobble/></link><link name="b"><visual><geometry><box size="1 1 0.1"/></geometry></visual></link>
<joint name="j" type="revolute" spin="1"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
<origin xyz="0 0 0.6"/><limit lower="0" upper="0.1"/></joint></robot>"""
MJCF = """<mujoco><spinner/><worldbody><body name="a"><geom type="box" size="1 1 1"/><body name="b"
pos="0 0 1.2"><joint name="j" axis="1 0 0" range="0 5"/><geom type="box" size="1 1 0.1"/></body>
</body></worldbody></mujoco>"""


def test_check_prints_what_was_not_read(tmp_path: Path, capfd) -> None:
    for name, text in (("one/mobility.urdf", URDF), ("two/object.xml", MJCF)):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    options = ["check", str(tmp_path), "--format", "urdf", "--no-gate", "--jobs", "1"]
    assert main(options) == 0
    said = " ".join(capfd.readouterr().out.split())
    assert "one: ignored:" in said and "<wobble> in <link> (1)" in said
    assert "attribute 'spin' of <joint> (1)" in said
    assert "two: ignored: <spinner> in <mujoco> (1)" in said
    assert main([*options, "--json"]) == 0
    rows = json.loads(capfd.readouterr().out)["assets"]
    assert all(any(n.startswith("ignored") for n in row["notes"]) for row in rows)
