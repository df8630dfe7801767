"""Values of small files changed one by one, not bytes: what changes for the software or the rules
of a format changes here in the same way, or a remark tells it.

Rows are ``old => new => what changes``, or ``! words of a remark``. What changes is worked out by
usd-core, MuJoCo and trimesh where a row leaves it open; of URDF and SDF it is what their
specifications say, of LAS what laspy reads, times its unit.
"""

import copy
import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from model.core.asset import Asset
from model.geometry.sampling import face_colors
from model.io.open_asset import open_asset
from tests.builders import write_glb
from tests.model.io.test_field_scans_and_sdf import CLOUD, FOOT, PROJCS, las
from tests.model.io.test_usd_reports import box

Facts = dict[str, Any]
"""What is said of a part or a joint, such as ``range hinge`` or ``box door``."""
FREE = (-math.inf, math.inf)


def facts(asset: Asset) -> Facts:
    """Boxes and colours of parts; axes, places, ranges and resistance of joints; masses."""
    out: Facts = {}
    mesh, names = asset.mesh, asset.part_names
    assert mesh is not None and asset.element_part is not None and asset.tree is not None
    colors = face_colors(mesh)
    for part, name in enumerate(names):
        mine = asset.element_part == part
        points, link = mesh.triangles[mine].reshape(-1, 3), f"link_{part}"
        if len(points):
            out[f"box {name}"] = [*points.min(0), *points.max(0)]
        out[f"colours {name}"] = sorted(set(map(tuple, colors[mine].tolist())))
        if (held := asset.inertials.get(link)) is not None:
            out |= {f"mass {name}": held.mass, f"centre {name}": held.center}
            out[f"inertia {name}"] = held.tensor[[0, 1, 2, 0], [0, 1, 2, 1]]
        out[f"shapes {name}"] = len(asset.shapes.get(link, ()))
    for joint in asset.tree.joints:
        out[f"kind {joint.name}"] = joint.type
        out[f"axis {joint.name}"], out[f"at {joint.name}"] = joint.axis, joint.origin
        ends, said = (joint.lower, joint.upper), joint.dynamics
        out[f"range {joint.name}"] = FREE if None in ends else ends
        for what in ("damping", "friction", "effort", "velocity"):
            out[f"{what} {joint.name}"] = None if said is None else getattr(said, what)
        if joint.mimic is not None:
            out[f"follows {joint.name}"] = (joint.mimic.multiplier, joint.mimic.offset)
    return out


def same(a: Any, b: Any) -> bool:
    if a is None or b is None or isinstance(a, str):
        return (a or None) == (b or None)
    if isinstance(a, list) and a and isinstance(a[0], tuple):  # colours
        return len(a) == len(b) and np.abs(np.array(a) - np.array(b)).max() < 2
    return np.allclose(a, b, atol=2e-3, rtol=2e-3)


def stated(text: str) -> Facts:
    """Facts as rows have them: numbers, ``free``, ``none``, ``#rrggbbaa``, a word."""
    out: Facts = {}
    for what, _, value in (each.partition(": ") for each in text.split("; ") if each):
        words = value.split()
        if value.startswith("#"):
            out[what] = [tuple(bytes.fromhex(word[1:])) for word in words]
        elif value in ("free", "none"):
            out[what] = FREE if value == "free" else None
        elif what.startswith(("kind", "parts")):
            out[what] = value
        else:
            numbers = [float(word) for word in words]
            out[what] = numbers if len(numbers) > 1 else numbers[0]
    return out


def rows_of(table: str) -> list[Any]:
    out = []
    for line in (row for row in table.strip("\n").split("\n") if not row.startswith("# ")):
        old, new, says = (part.strip(" ") for part in f"{line} ".split(" => ", 2))
        out.append(pytest.param(old, new, says, id=f"{old[:30]} {new[:50]}"))
    return out


def changed(text: str, old: str, new: str) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


def opened(path: Path, text: str) -> Asset:
    trimesh.creation.box((0.8, 0.02, 1)).export(path.with_name("m.stl"))
    Image.new("RGB", (4, 4), (204, 102, 51)).save(path.with_name("t.png"))
    path.write_text(text)
    return open_asset(path)


@cache
def before(folder: Path, name: str, text: str) -> tuple[Facts, tuple[str, ...]]:
    asset = opened(folder / name, text)
    return facts(asset), asset.warnings


def holds(asset: Asset, expected: Facts, warnings: tuple[str, ...], says: str) -> None:
    """As expected, with remarks as before; or a further remark that ``says`` names."""
    further, told = " | ".join(set(asset.warnings) - set(warnings)), says.startswith("! ")
    assert (says[2:] in further) if told else not further, further
    if not told:
        found = facts(asset)
        wrong = {k: (v, found.get(k)) for k, v in expected.items() if not same(v, found.get(k))}
        assert not wrong


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("before")


URDF = """<robot name="cab">
<material name="blue"><color rgba="0.2 0.4 0.8 1"/></material>
<link name="base"><inertial><origin xyz="0 0 0.5"/><mass value="20"/>
<inertia ixx="2" ixy="0" ixz="0" iyy="2.5" iyz="0" izz="1.5"/></inertial>
<visual><origin xyz="0 0 0.5" rpy="0 0 0"/><geometry><box size="0.8 0.6 1"/></geometry>
<material name="wood"><color rgba="0.8 0.4 0.2 1"/></material></visual>
<collision><origin xyz="0 0 0.5"/><geometry><box size="0.8 0.6 1"/></geometry></collision></link>
<link name="door"><visual><origin xyz="0.4 -0.01 0"/><geometry><mesh filename="m.stl"/></geometry>
<material name="blue"/></visual></link>
<link name="drawer"><visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual></link>
<joint name="hinge" type="revolute"><origin xyz="-0.4 -0.3 0.5"/><parent link="base"/>
<child link="door"/><axis xyz="0 0 1"/><limit lower="-1.5" upper="0.2" effort="10" velocity="2"/>
<dynamics damping="0.7" friction="0.2"/></joint>
<joint name="slide" type="prismatic"><origin xyz="0 0.3 0.8"/><parent link="base"/>
<child link="drawer"/><axis xyz="0 1 0"/><limit lower="0" upper="0.3" effort="5" velocity="1"/>
</joint></robot>"""
URDF_ROWS = """
# colours and textures of materials, by name, also of other links
rgba="0.2 0.4 0.8 1" => rgba="1 0 0 0.5" => colours door: #ff000080
<color rgba="0.2 0.4 0.8 1"/> => <texture filename="t.png"/> => colours door: #cc6633ff
<box size="0.2 0.2 0.2"/></geometry> => <box size="0.2 0.2 0.2"/></geometry><material \
name="blue"/> => colours drawer: #3366ccff
<box size="0.2 0.2 0.2"/></geometry> => <box size="0.2 0.2 0.2"/></geometry><material \
name="wood"/> => colours drawer: #cc6633ff
<box size="0.2 0.2 0.2"/></geometry> => <box size="0.2 0.2 0.2"/></geometry><material \
name="gone"/> => ! materials that nothing describes: 'gone'
<box size="0.2 0.2 0.2"/></geometry> => <box size="0.2 0.2 0.2"/></geometry><material \
name="t"><texture filename="t.png"/></material> => colours drawer: #cc6633ff
# masses, inertia, their frames
value="20" => value="5" => mass base: 5
value="20" => value="-5" => ! none that a body can have
ixx="2" => ixx="2.2" => inertia base: 2.2 2.5 1.5 0
xyz="0 0 0.5"/><mass => xyz="0 0 0.5" rpy="0 0 1.5708"/><mass => inertia base: 2.5 2 1.5 0
# poses (rpy, quat_xyzw), scales
rpy="0 0 0" => rpy="0 0 1.5708" => box base: -0.3 -0.4 0 0.3 0.4 1
rpy="0 0 0" => quat_xyzw="0 0 1 1" => box base: -0.3 -0.4 0 0.3 0.4 1
"m.stl" => "m.stl" scale="1 1 2" => box door: -0.4 -0.32 -0.5 0.4 -0.3 1.5
# joints: revolute, continuous, prismatic, fixed, planar; others are fixed
type="revolute" => type="continuous" => kind hinge: continuous; range hinge: free
type="revolute" => type="prismatic" => kind hinge: prismatic
type="revolute" => type="floating" => ! floating joints are not supported
type="revolute" => type="planar" => ! is planar
# axes, ranges
<axis xyz="0 0 1"/> =>  => axis hinge: 1 0 0
<axis xyz="0 0 1"/> => <axis xyz="0 0 -1"/> => axis hinge: 0 0 -1
lower="-1.5" =>  => range hinge: 0 0.2
lower="-1.5" => lower="-10" => range hinge: -10 0.2
lower="-1.5" => lower="1" => ! were swapped
lower="-1.5" => lower="-inf" => ! became continuous
# effort, velocity, damping, friction
effort="10" => effort="20" => effort hinge: 20
effort="10" => effort="-1" => ! effort '-1' of joint 'hinge' is no amount
velocity="2" => velocity="3" => velocity hinge: 3
damping="0.7" => damping="1.7" => damping hinge: 1.7
damping="0.7" => damping="-1" => ! damping '-1' of joint 'hinge' is no amount
friction="0.2" =>  => friction hinge: 0
# mimics
velocity="1"/> => velocity="1"/><mimic joint="hinge" multiplier="0.5" offset="0.1"/> => follows \
slide: 0.5 0.1
# elements and attributes that no reader knows
</robot> => <loop_joint name="l"/></robot> => ! <loop_joint> in <robot> (1)
"""
SDF = """<sdf version="1.9"><model name="cab"><link name="base"><pose>0 0 0.5 0 0 0</pose>
<inertial><mass>20</mass><inertia><ixx>2</ixx><iyy>2.5</iyy><izz>1.5</izz></inertia></inertial>
<visual name="v"><geometry><box><size>0.8 0.6 1</size></box></geometry>
<material><ambient>1 0 0 1</ambient><diffuse>0.8 0.4 0.2 1</diffuse></material></visual>
<collision name="c"><geometry><box><size>0.8 0.6 1</size></box></geometry></collision></link>
<link name="door"><pose relative_to="base">-0.4 -0.3 0 0 0 0</pose>
<visual name="v"><pose>0.4 -0.01 0 0 0 0</pose><transparency>0</transparency>
<geometry><box><size>0.8 0.02 1</size></box></geometry>
<material><diffuse>0.2 0.4 0.8 1</diffuse></material></visual></link>
<frame name="f" attached_to="base"><pose>0 0.3 0.3 0 0 0</pose></frame>
<link name="drawer"><pose relative_to="f"/>
<visual name="v"><geometry><sphere><radius>0.1</radius></sphere></geometry></visual></link>
<joint name="hinge" type="revolute"><pose>0 0 0 0 0 0</pose><parent>base</parent><child>door</child>
<axis><xyz>0 0 1</xyz><limit><lower>-1.5</lower><upper>0.2</upper><effort>10</effort>
<velocity>2</velocity></limit><dynamics><damping>0.7</damping><friction>0.2</friction>
<spring_stiffness>0</spring_stiffness></dynamics></axis></joint>
<joint name="slide" type="prismatic"><parent>base</parent><child>drawer</child><axis>
<xyz>0 1 0</xyz><limit><lower>0</lower><upper>0.3</upper></limit></axis></joint></model></sdf>"""
SDF_ROWS = """
# poses and frames: relative_to, attached_to, degrees, quaternions
 relative_to="base">-0.4 => >-0.4 => box door: -0.4 -0.32 -0.5 0.4 -0.3 0.5; at hinge: -0.4 -0.3 0
<pose relative_to="f"/> => <pose relative_to="door"/> => at slide: -0.4 -0.3 0.5; box drawer: \
-0.5 -0.4 0.4 -0.3 -0.2 0.6
<pose relative_to="f"/> => <pose relative_to="f" degrees="1">0 0 0 0 0 90</pose> => axis slide: \
-1 0 0
<pose relative_to="f"/> => <pose relative_to="f" rotation_format="quat_xyzw">0 0 0 0 0 1 \
1</pose> => axis slide: -1 0 0
attached_to="base" =>  => at slide: 0 0.3 0.3; box drawer: -0.1 0.2 0.2 0.1 0.4 0.4
# masses, inertia
<mass>20</mass> => <mass>5</mass> => mass base: 5
<mass>20</mass> =>  => mass base: 1
<mass>20</mass> => <mass>-5</mass> => ! none that a body can have
<inertial><mass> => <inertial auto="true"><mass> => ! is that of its shapes (auto)
<ixx>2</ixx> =>  => inertia base: 1 2.5 1.5 0
<ixx>2</ixx> => <ixx>2</ixx><ixy>0.1</ixy> => inertia base: 2 2.5 1.5 0.1
# looks: diffuse, ambient, albedo_map, transparency; others are told
<diffuse>0.8 0.4 0.2 1</diffuse> =>  => colours base: #ff0000ff
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>1 1 0 0.5</diffuse> => colours base: #ffff0080
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>0.8 0.4 0.2 1</diffuse><emissive>1 1 1 1</emissive> \
=> ! its emissive colour is not read
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>0.8 0.4 0.2 \
1</diffuse><script><name>Gazebo/Red</name></script> => ! 'Gazebo/Red' is not read
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>0.8 0.4 0.2 \
1</diffuse><pbr><metal><metalness>1</metalness></metal></pbr> => ! <metalness> in <metal>
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>0.8 0.4 0.2 \
1</diffuse><pbr><specular><normal_map>t.png</normal_map></specular></pbr> => ! <normal_map> in \
<specular>
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>1 1 1 \
1</diffuse><pbr><metal><albedo_map>t.png</albedo_map></metal></pbr> => colours base: #cc6633ff
<diffuse>0.8 0.4 0.2 1</diffuse> => <diffuse>1 1 1 \
1</diffuse><pbr><specular><albedo_map>t.png</albedo_map></specular></pbr> => colours base: \
#cc6633ff
<transparency>0< => <transparency>0.5< => colours door: #3366cc80
# boxes, cylinders, spheres, capsules, meshes; other shapes are told
<size>0.8 0.02 1</size> =>  => box door: -0.5 -0.81 0 0.5 0.19 1
<radius>0.1</radius> => <radius>0.2</radius> => box drawer: -0.2 0.1 0.6 0.2 0.5 1
<radius>0.1</radius> =>  => box drawer: -1 -0.7 -0.2 1 1.3 1.8
<sphere><radius>0.1</radius></sphere></geometry> => <ellipsoid/></geometry></visual><visual \
name='w'><geometry><sphere><radius>0.1</radius></sphere></geometry> => ! a visual of <ellipsoid> \
is not read
# joints: places, parents, types, axes
0 0 0 0 0 0</pose><p => 0.1 0.2 0.3 0 0 0</pose><p => at hinge: -0.3 -0.1 0.8
0 0 0 0 0 0</pose><p => 0 0 0 0 1.5708 0</pose><p => axis hinge: 1 0 0
<parent>base</parent><child>door => <parent>world</parent><child>door => ! 'base' hangs on nothing
type="revolute" => type="continuous" => kind hinge: continuous; range hinge: free
type="revolute" => type="prismatic" => kind hinge: prismatic
type="revolute" => type="gearbox" => ! gearbox joints are not supported
type="revolute" => type="ball" => ! is a ball: read as three turns
<xyz>0 0 1</xyz> => <xyz>0 1 0</xyz> => axis hinge: 0 1 0
<xyz>0 1 0</xyz> =>  => axis slide: 0 0 1
# ranges; with one limit
<lower>-1.5</lower> => <lower>-10</lower> => range hinge: -10 0.2
<lower>-1.5</lower> =>  => ! has one limit alone (0.2): read as none
<lower>-1.5</lower><upper>0.2</upper> =>  => kind hinge: continuous; range hinge: free
<upper>0.3</upper> =>  => ! it slides from 0 to 0 m
# effort, velocity, damping, friction, springs
<effort>10</effort> => <effort>20</effort> => effort hinge: 20
<effort>10</effort> => <effort>-1</effort> => effort hinge: none
<damping>0.7</damping> => <damping>1.7</damping> => damping hinge: 1.7
<damping>0.7</damping> => <damping>-1</damping> => ! damping '-1' of joint 'hinge' is no amount
<spring_stiffness>0 => <spring_stiffness>3 => ! joint 'hinge' has a spring
# mimics
<upper>0.3</upper></limit> => <upper>0.3</upper></limit><mimic \
joint='hinge'><multiplier>2</multiplier><offset>1</offset></mimic> => follows slide: 2 1
<upper>0.3</upper></limit> => <upper>0.3</upper></limit><mimic \
joint='hinge'><multiplier>2</multiplier><offset>1</offset><reference>0.25</reference></mimic> => \
follows slide: 2 0.5
# static models, elements that no reader knows
</model> => <static>1</static></model> => ! Gazebo moves nothing
</model> => <gripper name='g'/></model> => ! <gripper> in <model> (1)
"""


def by_rules(path: Path, text: str, folder: Path, row: tuple[str, str, str]) -> None:
    old, new, says = row
    known, warnings = before(folder, path.name, text)
    expected = stated("" if says.startswith("! ") else says)
    holds(opened(path, changed(text, old, new)), known | expected, warnings, says)


@pytest.mark.parametrize(("old", "new", "says"), rows_of(URDF_ROWS))
def test_changes_of_urdf(old: str, new: str, says: str, folder: Path, tmp_path: Path) -> None:
    by_rules(tmp_path / "a.urdf", URDF, folder, (old, new, says))


@pytest.mark.parametrize(("old", "new", "says"), rows_of(SDF_ROWS))
def test_changes_of_sdf(old: str, new: str, says: str, folder: Path, tmp_path: Path) -> None:
    by_rules(tmp_path / "a.sdf", SDF, folder, (old, new, says))


# MJCF, as MuJoCo compiles it

MJCF = """<mujoco model="cab"><compiler angle="degree"/>
<default><geom rgba="0.8 0.4 0.2 1"/><joint damping="0.5"/>
<default class="metal"><geom rgba="0.2 0.2 0.3 1" density="2700"/><joint frictionloss="0.1"/>
</default></default>
<asset><mesh name="m" file="m.stl"/><material name="mat" rgba="0.1 0.9 0.1 1"/></asset>
<worldbody><body name="base"><geom type="box" size="0.4 0.3 0.5" pos="0 0 0.5" mass="20"/>
<body name="door" pos="-0.4 -0.3 0.5" euler="0 0 0">
<inertial pos="0.4 0 0" mass="3" diaginertia="0.3 0.35 0.2"/>
<joint name="hinge" axis="0 0 1" range="-90 0"/>
<geom type="box" size="0.4 0.01 0.5" pos="0.4 -0.01 0"/>
<geom type="capsule" fromto="0.7 -0.02 0 0.7 -0.06 0" size="0.01" material="mat"/></body>
<body name="drawer" pos="0 0.3 0.8" childclass="metal">
<joint name="slide" type="slide" axis="0 1 0" range="0 0.3"/>
<geom type="mesh" mesh="m"/></body></body></worldbody>
<equality><joint joint1="slide" joint2="hinge" polycoef="0 0.1"/></equality></mujoco>"""
MJCF_ROWS = """
# compiler: angles, orders, masses
angle="degree" => angle="radian" =>
angle="degree" => angle="degree" eulerseq="zyx" inertiafromgeom="true" =>
angle="degree" => angle="degree" settotalmass="10" =>
angle="degree" => angle="degree" boundmass="5" =>
# defaults and classes
<joint damping="0.5"/> =>  =>
<joint damping="0.5"/> => <joint damping="-1"/> => ! damping is read where it is linear
<joint damping="0.5"/> => <joint damping="0.5 0.1"/> => ! damping is read where it is linear
<geom rgba="0.8 0.4 0.2 1"/> => <geom rgba="1 0 0 0.5" contype="0" conaffinity="0"/> =>
<geom rgba="0.8 0.4 0.2 1"/> => <geom rgba="0.8 0.4 0.2 1" group="3"/> => ! all were taken
# meshes: scale, refpos, refquat
name="m" file => scale="2 -1 1" refpos="0.1 0 0" refquat="1 0 0 1" name="m" file =>
# colours of geoms and materials
rgba="0.1 0.9 0.1 1" => rgba="0 0 1 0.2" =>
# masses, densities, inertia
mass="20" => mass="5" =>
mass="20" => density="200" =>
pos="0.4 0 0" mass="3" => pos="0.3 0 0.1" mass="4" euler="0 0 30" =>
diaginertia="0.3 0.35 0.2" => fullinertia="0.3 0.35 0.2 0.01 0 0" =>
# poses of bodies; mocap, gravcomp
euler="0 0 0" => euler="20 30 40" =>
name="base" => name="base" pos="1 2 3" =>
name="base" => name="base" mocap="true" => ! bodies moved by motion capture
name="base" => name="base" gravcomp="1" => ! compensation of gravity
# hinges and slides: axes, places, ranges, ref
name="hinge" => name="hinge" type="slide" =>
axis="0 0 1" => axis="1 1 0" =>
axis="0 0 1" => axis="0 0 -5" pos="0.1 0.2 0.3" =>
range="-90 0" => range="-90 400" =>
range="-90 0" => range="-180 180" =>
range="-90 0" => range="-90 0" limited="false" =>
range="-90 0" =>  =>
range="-90 0" => range="30 -30" => ! in the wrong order
range="-90 0" => range="-90 0" ref="20" =>
# damping, friction, effort; springs, armature
range="-90 0" => range="-90 0" stiffness="3" => ! has a spring
range="-90 0" => range="-90 0" armature="3" => ! armature
range="-90 0" => range="-90 0" damping="3" frictionloss="4" actuatorfrcrange="-3 5" =>
range="-90 0" => range="-90 0" class="metal" =>
range="0 0.3" => range="0 0.3" ref="0.1" =>
range="0 0.3" =>  => ! slides without limits
# geoms: shapes, poses, groups
type="box" size="0.4 0.01 0.5" => type="cylinder" size="0.4 0.01" =>
type="box" size="0.4 0.01 0.5" => type="box" size="0.4 0.01 0.5" group="3" =>
type="box" size="0.4 0.01 0.5" => type="box" size="0.4 0.01 0.5" rgba="0 0 1 0" =>
type="box" size="0.4 0.01 0.5" => type="box" size="0.4 0.01 0.5" axisangle="0 0 1 30" =>
type="box" size="0.4 0.01 0.5" => type="box" size="0.4 0.01 0.5" zaxis="0 1 0" class="metal" =>
type="box" size="0.4 0.01 0.5" => type="mesh" mesh="m" xyaxes="0 1 0 1 0 0" =>
type="box" size="0.4 0.01 0.5" => type="box" size="0.4 0.01 0.5" friction="1" => ! friction
fromto="0.7 -0.02 0 0.7 -0.06 0" size="0.01" => size="0.01 0.05" quat="1 1 0 0" =>
childclass="metal" => childclass="metal" quat="1 0 0 1" =>
# couplings (equality)
polycoef="0 0.1" => polycoef="0.2 -0.3" =>
polycoef="0 0.1" => polycoef="0 0.1 0.2" => ! along a curve
polycoef="0 0.1" =>  =>
joint2="hinge" =>  => ! an equality of kind 'joint'
</equality> => <weld body1="door" body2="base"/></equality> => ! an equality of kind 'weld'
# actuators and tendons
</mujoco> => <actuator><motor joint="hinge"/></actuator></mujoco> => ! actuators
"""


def by_mujoco(path: Path) -> Facts:
    mujoco = pytest.importorskip("mujoco")
    m = mujoco.MjModel.from_xml_path(str(path))
    d, out = mujoco.MjData(m), Facts()
    mujoco.mj_kinematics(m, d)
    boxes: dict[int, list] = {}
    colors: dict[int, set] = {}
    for g in range(m.ngeom):
        look, turn, size = m.geom_matid[g], d.geom_xmat[g].reshape(3, 3), m.geom_size[g]
        rgba, kind, body = (
            m.mat_rgba[look] if look >= 0 else m.geom_rgba[g],
            m.geom_type[g],
            m.geom_bodyid[g],
        )
        if m.geom_group[g] > 2 or rgba[3] == 0:
            continue
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = m.geom_dataid[g]
            at = m.mesh_vertadr[mesh]
            corners = m.mesh_vert[at : at + m.mesh_vertnum[mesh]] @ turn.T
        elif kind == mujoco.mjtGeom.mjGEOM_BOX:
            corners = np.abs(turn) @ size * [[1], [-1]]
        else:  # capsule, cylinder: along the axis, and about it
            flat = 1.0 if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else np.sqrt(1 - turn[:, 2] ** 2)
            corners = (np.abs(turn[:, 2]) * size[1] + size[0] * flat) * [[1], [-1]]
        boxes.setdefault(body, []).append(corners + d.geom_xpos[g])
        colors.setdefault(body, set()).add(tuple(np.rint(255 * rgba).astype(int).tolist()))
    for body, held in boxes.items():
        name, points = m.body(body).name, np.concatenate(held)
        turn = d.ximat[body].reshape(3, 3)
        tensor = turn @ np.diag(m.body_inertia[body]) @ turn.T
        out[f"box {name}"] = [*points.min(0), *points.max(0)]
        out[f"colours {name}"] = sorted(colors[body])
        out |= {f"mass {name}": m.body_mass[body], f"centre {name}": d.xipos[body]}
        out[f"inertia {name}"] = tensor[[0, 1, 2, 0], [0, 1, 2, 1]]
    for j in range(m.njnt):
        name, dof = m.joint(j).name, m.jnt_dofadr[j]
        out |= {f"axis {name}": d.xaxis[j], f"at {name}": d.xanchor[j]}
        low, high = m.jnt_range[j] - m.qpos0[m.jnt_qposadr[j]]
        out[f"range {name}"] = (low, high) if m.jnt_limited[j] else FREE
        resists = {"damping": m.dof_damping[dof], "friction": m.dof_frictionloss[dof]}
        out |= {f"{k} {name}": v if any(resists.values()) else None for k, v in resists.items()}
        most = np.abs(m.jnt_actfrcrange[j]).max() if m.jnt_actfrclimited[j] else None
        out[f"effort {name}"] = most
    for e in range(m.neq):
        if m.eq_type[e] == mujoco.mjtEq.mjEQ_JOINT and m.eq_obj2id[e] >= 0:
            offset, slope = m.eq_data[e][:2]
            out[f"follows {m.joint(m.eq_obj1id[e]).name}"] = (slope, offset)
    return out


# USD, as usd-core says

USD = f"""#usda 1.0
(
 defaultPrim = "Cabinet"
 metersPerUnit = 1
 kilogramsPerUnit = 1
 upAxis = "Z"
)
def Xform "Cabinet" {{
def Material "wood" {{
 token outputs:surface.connect = </Cabinet/wood/s.outputs:surface>
 def Shader "s" {{
  uniform token info:id = "UsdPreviewSurface"
  color3f inputs:diffuseColor = (0.5, 0.2, 0.1)
  float inputs:opacity = 1
  token outputs:surface
 }}
}}
def Xform "base" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{
bool physics:kinematicEnabled = 0
float physics:mass = 20
{box((-0.4, -0.3, 0), (0.4, 0.3, 1))}
}}
def Xform "door" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{
float physics:mass = 3
point3f physics:centerOfMass = (0.4, -0.01, 0)
float3 physics:diagonalInertia = (0.3, 0.35, 0.2)
quatf physics:principalAxes = (1, 0, 0, 0)
double3 xformOp:translate = (-0.4, -0.3, 0.5)
quatd xformOp:orient = (1, 0, 0, 0)
double3 xformOp:scale = (1, 1, 1)
uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]
{box((0, -0.02, -0.5), (0.8, 0, 0.5), "rel material:binding = </Cabinet/wood>", "panel")}
}}
def Xform "drawer" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {{
float physics:density = 400
double3 xformOp:translate = (0, 0.3, 0.8)
float3 xformOp:rotateXYZ = (0, 0, 0)
uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
def Cylinder "c" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {{
double radius = 0.1
double height = 0.3
uniform token axis = "Y"
color3f[] primvars:displayColor = [(0.3, 0.6, 0.2)]
}}
}}
def PhysicsRevoluteJoint "hinge" (
prepend apiSchemas = ["PhysicsDriveAPI:angular", "PhysxJointAPI"]
) {{
rel physics:body0 = </Cabinet/base>
rel physics:body1 = </Cabinet/door>
uniform token physics:axis = "Z"
point3f physics:localPos0 = (-0.4, -0.3, 0.5)
quatf physics:localRot0 = (1, 0, 0, 0)
point3f physics:localPos1 = (0, 0, 0)
quatf physics:localRot1 = (1, 0, 0, 0)
float physics:lowerLimit = -90
float physics:upperLimit = 10
float physics:breakForce = inf
float drive:angular:physics:maxForce = 20
float drive:angular:physics:damping = 0.1
float drive:angular:physics:stiffness = 0
float physxJoint:armature = 0
}}
def PhysicsPrismaticJoint "slide" (prepend apiSchemas = ["PhysicsDriveAPI:linear"]) {{
rel physics:body0 = </Cabinet/base>
rel physics:body1 = </Cabinet/drawer>
uniform token physics:axis = "Y"
point3f physics:localPos0 = (0, 0.3, 0.8)
float physics:lowerLimit = 0
float physics:upperLimit = 0.3
float drive:linear:physics:damping = 5
}}
}}
"""
USD_ROWS = """
metersPerUnit = 1 => metersPerUnit = 0.01 =>
metersPerUnit = 1 => doc = "" =>
kilogramsPerUnit = 1 => kilogramsPerUnit = 0.001 =>
upAxis = "Z" => upAxis = "Y" =>
diffuseColor = (0.5, 0.2, 0.1) => diffuseColor = (0, 0.5, 2) =>
inputs:opacity = 1 => inputs:opacity = 0.4 =>
inputs:opacity = 1 => inputs:opacity = 0.4\\n float inputs:opacityThreshold = 0.3 =>
inputs:opacity = 1 => inputs:opacity = 1\\n color3f inputs:emissiveColor = (1, 1, 1) => ! emission
kinematicEnabled = 0 => kinematicEnabled = 1 => ! physics:kinematicEnabled (1)
kinematicEnabled = 0 => startsAsleep = 1 => ! physics:startsAsleep (1)
mass = 20 => mass = 5 =>
mass = 20 => mass = -5 => ! physics:mass (1)
mass = 20 => mass = nan => ! physics:mass (1)
mass = 3 => mass.timeSamples = {5: 9, 1: 4} => ! of 1 values over time the earliest count
density = 400 => density = 800 =>
density = 400 => density = -400 => ! physics:density (1)
centerOfMass = (0.4, -0.01, 0) => centerOfMass = (0.3, 0, 0.1) =>
diagonalInertia = (0.3, 0.35, 0.2) => diagonalInertia = (0.4, 0.5, 0.6) =>
principalAxes = (1, 0, 0, 0) => principalAxes = (0.5, 0.5, 0.5, 0.5) =>
translate = (0, 0.3, 0.8) => translate = (0, 0.5, 0.8) =>
translate = (0, 0.3, 0.8) => translate = (0.2, 0.3, 0.8) => ! its frames stand 0.2 m apart
orient = (1, 0, 0, 0) => orient = (0.8, 0, 0, 0.6) =>
orient = (1, 0, 0, 0) => orient = (0.8, 0.6, 0, 0) => ! its frames stand 73.7 degrees apart
xformOp:scale = (1, 1, 1) => xformOp:scale = (-1, -1, -2) =>
xformOp:scale = (1, 1, 1) => xformOp:scale = (1, -1, 2) => ! its frames stand 180 degrees apart
"xformOp:orient", "xformOp:scale"] => "xformOp:scale"] =>
"xformOp:translate", "xformOp:rotateXYZ" => "xformOp:rotateXYZ", "xformOp:translate" =>
rotateXYZ = (0, 0, 0) => rotateXYZ = (0, 20, 0) => ! its frames stand 20 degrees apart
double radius = 0.1 => double radius = 0.2 =>
double height = 0.3 =>  =>
token axis = "Y" => token axis = "X" =>
def Cylinder => def Capsule =>
def Cylinder => def Cone =>
def Cylinder => def Cylinder_1 => ! Cylinder_1 (1)
[(0.3, 0.6, 0.2)] => [(1, 0, 0)] =>
def Mesh "panel" => over Mesh "panel" => ! joints that carry nothing were left out: hinge
subdivisionScheme = "none" => subdivisionScheme = "loop" => ! subdivisionScheme (1)
subdivisionScheme = "none" => subdivisionScheme = "none"\\nuniform token physics:approximation \
= "boundingCube" => ! physics:approximation (1)
def PhysicsRevoluteJoint => def PhysicsSphericalJoint => ! is a ball: read as three turns
def PhysicsRevoluteJoint => def PhysicsDistanceJoint => ! read as fixed
def PhysicsRevoluteJoint "hinge" ( => def PhysicsRevoluteJoint "hinge" (\\nactive = false => \
! body 'door' hangs on no joint
physics:body1 = </Cabinet/door> => physics:body1 = </Cabinet/door/panel> =>
uniform token physics:axis = "Z" =>  =>
physics:axis = "Z" => physics:axis = "Y" =>
localPos0 = (-0.4, -0.3, 0.5) => localPos0 = (0, 0, 0) => ! its frames stand 0.707 m apart
localRot0 = (1, 0, 0, 0) => localRot0 = (0.8, 0, 0, 0.6) =>
localRot0 = (1, 0, 0, 0) => localRot0 = (0.8, 0, 0.6, 0) => ! its frames stand 73.7 degrees apart
localRot1 = (1, 0, 0, 0) => localRot1 = (0.8, 0, 0, 0.6) =>
lowerLimit = -90 => lowerLimit = -900 =>
lowerLimit = -90 => lowerLimit = -inf => ! has one limit
lowerLimit = -90 => lowerLimit = 90 => ! has no range
breakForce = inf => breakForce = 0 => ! physics:breakForce (1)
float physics:breakForce = inf => bool physics:collisionEnabled = 1 => ! :collisionEnabled (1)
float physics:breakForce = inf => bool physics:jointEnabled = 0 => ! 'hinge' is switched off
maxForce = 20 => maxForce = 30 =>
angular:physics:damping = 0.1 => angular:physics:damping = 0.5 =>
angular:physics:damping = 0.1 => angular:physics:damping = -1 => ! drive:angular:physics:damping (1)
stiffness = 0 => stiffness = 3 => ! drive:angular:physics:stiffness (1)
float drive:angular:physics:stiffness = 0 => uniform token drive:angular:physics:type = \
"acceleration" => ! damping by acceleration
armature = 0 => armature = 0.2 => ! physxJoint:armature (1)
armature = 0 => gone = 0.2 => ! physxJoint:gone (1)
upperLimit = 0.3 => upperLimit = 0.3\\nrel physxMimicJoint:rotX:referenceJoint = </Cabinet/hinge> \
=> ! without a stated gearing
"""


def by_usd(path: Path) -> Facts:
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

    stage, out = Usd.Stage.Open(str(path)), Facts()
    time, unit = Usd.TimeCode.EarliestTime(), UsdGeom.GetStageMetersPerUnit(stage)
    kilograms = UsdPhysics.GetStageKilogramsPerUnit(stage)
    up = np.eye(3) if UsdGeom.GetStageUpAxis(stage) == "Z" else [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    places = UsdGeom.XformCache(time)
    for body in (p for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)):
        points, colors = [], set()
        for prim in (p for p in Usd.PrimRange(body) if p.IsA(UsdGeom.Gprim)):
            low, high = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), time)
            corners = [
                (x, y, z)
                for x in (low[0], high[0])
                for y in (low[1], high[1])
                for z in (low[2], high[2])
            ]
            world = places.GetLocalToWorldTransform(prim)
            points += [world.Transform(Gf.Vec3d(*map(float, c))) for c in corners]
            look = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
            rgb, alpha = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(time) or [None], 1.0
            rgb = rgb[0]
            if look:
                given = {
                    i.GetBaseName(): i.Get(time)
                    for i in UsdShade.Shader(look.ComputeSurfaceSource()[0]).GetInputs()
                }
                rgb, alpha = given["diffuseColor"], given["opacity"]
                alpha = (
                    float(alpha >= given["opacityThreshold"])
                    if "opacityThreshold" in given
                    else alpha
                )
            linear = np.clip((0.58,) * 3 if rgb is None else rgb, 0, 1)
            srgb = np.where(
                linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055
            )
            colors.add((*np.rint(255 * srgb).astype(int).tolist(), round(255 * alpha)))
        points, name = np.array(points) @ np.transpose(up) * unit, body.GetName()
        out[f"box {name}"], out[f"colours {name}"] = (
            [*points.min(0), *points.max(0)],
            sorted(colors),
        )
        mass = UsdPhysics.MassAPI(body).GetMassAttr().Get(time)
        out |= {f"mass {name}": mass * kilograms} if mass else {}
    found = UsdPhysics.LoadUsdPhysicsFromRange(stage, [Sdf.Path("/")])
    for kind in (UsdPhysics.ObjectType.RevoluteJoint, UsdPhysics.ObjectType.PrismaticJoint):
        for at, joint in zip(*found.get(kind, ([], [])), strict=True):
            turns = kind == UsdPhysics.ObjectType.RevoluteJoint
            size = math.pi / 180 if turns else unit
            force = kilograms * unit ** (2 if turns else 1)
            frames = []
            for k, body in enumerate((joint.body0, joint.body1)):
                own = (
                    getattr(joint, f"localPose{k}Orientation"),
                    getattr(joint, f"localPose{k}Position"),
                )
                world = places.GetLocalToWorldTransform(
                    stage.GetPrimAtPath(body)
                ).RemoveScaleShear()
                frames.append(Gf.Matrix4d(Gf.Rotation(Gf.Quatd(own[0])), Gf.Vec3d(own[1])) * world)
            axes = {"X": (0, 1), "Y": (1, 2), "Z": (2, 0)}[str(joint.axis)[-1]]
            (along, side), (_, other) = ([np.array(f.GetRow3(k)) for k in axes] for f in frames)
            shift = np.array(frames[1].ExtractTranslation() - frames[0].ExtractTranslation())
            now = (
                math.atan2(np.cross(side, other) @ along, side @ other) / size
                if turns
                else shift @ along
            )
            out[f"axis {at.name}"] = np.asarray(up) @ along
            out[f"at {at.name}"] = np.asarray(up) @ frames[0].ExtractTranslation() * unit
            out[f"range {at.name}"] = tuple(
                (v - now) * size for v in (joint.limit.lower, joint.limit.upper)
            )
            out[f"damping {at.name}"] = joint.drive.damping * force / size
            most = joint.drive.forceLimit
            out[f"effort {at.name}"] = most * force if most < 1e12 else None
    return out


REFERENCES: dict[str, tuple[str, Callable[[Path], Facts]]] = {
    "a.xml": (MJCF, by_mujoco),
    "a.usda": (USD, by_usd),
}


def by_reference(path: Path, folder: Path, old: str, new: str, says: str) -> None:
    text, reference = REFERENCES[path.name]
    _, warnings = before(folder, path.name, text)
    asset = opened(path, changed(text, old, new.replace("\\n", "\n")))
    holds(asset, {} if says else reference(path), warnings, says)


@pytest.mark.parametrize(("old", "new", "says"), rows_of(MJCF_ROWS))
def test_changes_of_mjcf(old: str, new: str, says: str, folder: Path, tmp_path: Path) -> None:
    by_reference(tmp_path / "a.xml", folder, old, new, says)


@pytest.mark.parametrize(("old", "new", "says"), rows_of(USD_ROWS))
def test_changes_of_usd(old: str, new: str, says: str, folder: Path, tmp_path: Path) -> None:
    by_reference(tmp_path / "a.usda", folder, old, new, says)


@pytest.mark.parametrize("name", REFERENCES)
def test_references_agree_before(name: str, folder: Path) -> None:
    text, reference = REFERENCES[name]
    known, warnings = before(folder, name, text)
    assert not warnings
    wrong = {k: v for k, v in reference(folder / name).items() if not same(v, known.get(k))}
    assert not wrong


# glTF, as trimesh reads it

BLOCK = trimesh.creation.box((1, 2, 3))
ARRAYS = (
    np.float32(BLOCK.vertices),
    np.uint16(BLOCK.faces),
    np.tile(np.uint8([255, 128, 0, 255]), (8, 1)),
    np.full((8, 2), 0.3, np.float32),
)
KINDS = ((5126, "VEC3", 8), (5123, "SCALAR", 36), (5121, "VEC4", 8), (5126, "VEC2", 8))
TREE: dict[str, Any] = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [
        {"children": [1, 2], "translation": [0, 0, 0]},
        {"mesh": 0, "translation": [0, 1, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]},
        {"mesh": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1]},
    ],
    "meshes": [
        {
            "primitives": [
                {"attributes": {"POSITION": 0, "TEXCOORD_0": 3}, "indices": 1, "material": 0}
            ]
        },
        {
            "primitives": [
                {"attributes": {"POSITION": 0, "COLOR_0": 2}, "indices": 1, "material": 1}
            ]
        },
    ],
    "materials": [
        {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 0.4]}},
        {"pbrMetallicRoughness": {}},
    ],
    "images": [{"uri": "t.png"}],
    "textures": [{"source": 0}],
    "accessors": [
        {"bufferView": k, "componentType": c, "type": t, "count": n, "normalized": k == 2}
        for k, (c, t, n) in enumerate(KINDS)
    ],
    "bufferViews": [
        {"buffer": 0, "byteLength": a.nbytes, "byteOffset": sum(b.nbytes for b in ARRAYS[:k])}
        for k, a in enumerate(ARRAYS)
    ],
    "buffers": [{"byteLength": sum(a.nbytes for a in ARRAYS)}],
}
PAINTED = '{"baseColorTexture": {"index": 0}}'
GLTF_ROWS = f"""
# nodes, meshes and scenes; lines and points
nodes.0.translation => [1, 1, 1] =>
nodes.1.translation => gone =>
nodes.1.rotation => [0, 0, 0.6, 0.8] =>
nodes.1.scale => [-1, 2, 1] =>
nodes.2.matrix => [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1] =>
nodes.0.children => [1] => colours: #ff0000ff
nodes.1.mesh => 1 => colours: #ffbc00ff
nodes.1.extensions => {{"EXT_mesh_gpu_instancing": {{}}}} =>
scenes.0.nodes => [2] => colours: #ffbc00ff
meshes.0.primitives.0.mode => 1 => ! 1 pieces of lines
meshes.0.primitives.0.mode => 0 => ! 8 points beside the triangles
meshes.0.primitives.0.material => gone => colours: #c8c8c8ff #ffbc00ff
accessors.1.componentType => 5122 =>
bufferViews.0.byteStride => 12 =>
# colour, texture and opacity of materials
materials.0.pbrMetallicRoughness.baseColorFactor => [0, 0, 1, 1] => colours: #0000ffff #ffbc00ff
materials.0.alphaMode => "BLEND" => colours: #ff000066 #ffbc00ff
materials.0.alphaMode => "MASK" => colours: #ff000000 #ffbc00ff
materials.0 => {{"alphaMode": "MASK", "alphaCutoff": 0.3, "pbrMetallicRoughness": {{\
"baseColorFactor": [1, 0, 0, 0.4]}}}} => colours: #ff0000ff #ffbc00ff
materials.0.pbrMetallicRoughness => {PAINTED} => colours: #0080ffff #ffbc00ff
materials.0 => {{"alphaMode": "BLEND", "pbrMetallicRoughness": {PAINTED}}} => \
colours: #0080ff33 #ffbc00ff
materials.0.extensions => {{"KHR_materials_transmission": {{"transmissionFactor": 1}}}} => \
! light that shines through
# extensions, animations
extensionsUsed => ["KHR_node_visibility"] => ! extensions KHR_node_visibility
animations => [{{}}, {{}}] => ! animations (2)
"""


def edited(path: str, value: str) -> dict[str, Any]:
    tree = at = copy.deepcopy(TREE)
    *above, last = (int(key) if key.isdecimal() else key for key in path.split("."))
    for key in above:
        at = at[key]
    if value == "gone":
        del at[last]
    else:
        at[last] = json.loads(value)
    return tree


def solid(triangles: np.ndarray) -> Facts:
    a, b, c = np.moveaxis(triangles, 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    return {"box": [*triangles.min((0, 1)), *triangles.max((0, 1))], "volume": volume}


@pytest.mark.parametrize(("where", "value", "says"), rows_of(GLTF_ROWS))
def test_changes_of_gltf(where: str, value: str, says: str, tmp_path: Path) -> None:
    Image.new("RGBA", (4, 4), (0, 128, 255, 51)).save(tmp_path / "t.png")
    tree = edited(where, value)
    path = write_glb(tmp_path / "a.glb", tree, b"".join(a.tobytes() for a in ARRAYS))
    asset, told = open_asset(path), says.startswith("! ")
    assert (says[2:] in " | ".join(asset.warnings)) if told else not asset.warnings
    assert asset.mesh is not None
    found = solid(asset.mesh.triangles @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # y up again
    found["colours"] = sorted(set(map(tuple, face_colors(asset.mesh).tolist())))
    expected = {"colours": [(255, 0, 0, 255), (255, 188, 0, 255)]}
    shapes = trimesh.load(path, force="scene", process=False).dump()
    whole = np.concatenate([s.triangles for s in shapes if isinstance(s, trimesh.Trimesh)])
    expected |= solid(whole) | stated("" if told else says)
    if "left out" not in str(asset.warnings):
        assert {k: v for k, v in expected.items() if not same(v, found[k])} == {}


# Scans, as laspy and pye57 read them

HALF = np.arange(len(CLOUD)) % 2 == 1
SHADES = np.tile(np.uint16([65535, 32896, 0]), (len(CLOUD), 1))
NO_UNIT = "unit: metres taken"
LAS_ROWS: dict[str, tuple[dict, tuple[float, float], Any, tuple[str, ...]]] = {
    "plain": ({}, (1, 1), None, ("none stated",)),
    "withheld": ({"withheld": HALF}, (1, 1), None, ("points flagged as withheld",)),
    "low noise": ({"classification": HALF * np.uint8(7)}, (1, 1), None, ("classified as noise",)),
    "high noise": ({"classification": HALF * np.uint8(18)}, (1, 1), None, ("classified as noise",)),
    "ground": ({"classification": HALF * np.uint8(2)}, (1, 1), None, (NO_UNIT,)),
    "synthetic": ({"synthetic": HALF}, (1, 1), None, (NO_UNIT,)),
    "intensity": ({"intensity": SHADES[:, 0]}, (1, 1), None, ("intensities are left out",)),
    "colours": (
        dict(zip(("red", "green", "blue"), SHADES.T, strict=True)),
        (1, 1),
        (255, 128, 0),
        (NO_UNIT,),
    ),
    "colours of 8 bits": (
        dict(zip(("red", "green", "blue"), SHADES.T >> 8, strict=True)),
        (1, 1),
        (255, 128, 0),
        (NO_UNIT,),
    ),
    "feet": ({"records": ((1024, 1), (3076, 9002))}, (0.3048, 0.3048), None, ("unit: feet",)),
    "survey feet": (
        {"records": ((1024, 1), (3076, 9003))},
        (FOOT, FOOT),
        None,
        ("US survey feet",),
    ),
    "kilometres": ({"records": ((1024, 1), (3076, 9036))}, (1000, 1000), None, ("unit: 1000 m",)),
    "heights": ({"records": ((3076, 9001), (4099, 9002))}, (1, 0.3048), None, ("heights in feet",)),
    "fathoms": ({"records": ((1024, 1), (3076, 9014))}, (1, 1), None, ("EPSG:9014 isn't known",)),
    "from the centre": ({"records": ((1024, 3), (3076, 9001))}, (1, 1), None, ("geocentric",)),
    "text": ({"wkt": PROJCS.format(FOOT)}, (FOOT, FOOT), None, ("US survey feet", "'ft'")),
    "text without unit": (
        {"wkt": PROJCS.split(',UNIT["US')[0] + "]"},
        (1, 1),
        None,
        ("none stated",),
    ),
}


@pytest.mark.parametrize("name", LAS_ROWS)
def test_changes_of_las(name: str, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    said, (plane, height), shade, words = LAS_ROWS[name]
    path = las(tmp_path / "a.las", CLOUD, **said)
    read, asset = laspy.read(path), open_asset(path)
    noise = np.isin(np.asarray(read.classification), (7, 18))
    kept = ~(np.asarray(read.withheld, bool) | noise)
    right = np.column_stack([read.x, read.y, read.z])[kept] * (plane, plane, height)
    assert asset.cloud is not None and len(asset.cloud.points) == len(right)
    assert np.ptp(asset.cloud.points, axis=0) == pytest.approx(np.ptp(right, axis=0), rel=1e-4)
    colors = asset.cloud.colors
    assert (None if colors is None else tuple(colors[0].tolist())) == shade
    told = " | ".join(asset.warnings)
    assert all(word in told for word in words) and len(asset.warnings) == 1 + ("left out" in told)


TURNED = np.array([0.8, 0, 0, 0.6])
"""A quaternion, w first."""
E57_ROWS: dict[str, tuple[dict, dict, str]] = {
    "plain": ({}, {}, "one station"),
    "place": ({}, {"translation": np.array([1.0, 2, 3])}, "one station"),
    "turn": ({}, {"rotation": TURNED, "translation": np.array([1.0, 2, 3])}, "one station"),
    "invalid": ({"cartesianInvalidState": HALF.astype(np.int8)}, {}, "one station"),
    "intensity": ({"intensity": SHADES[:, 0] / 65535.0}, {}, "intensities are left out"),
    "colours": (
        dict(zip(("colorRed", "colorGreen", "colorBlue"), SHADES.T >> 8, strict=True)),
        {},
        "one station",
    ),
}


@pytest.mark.parametrize("name", E57_ROWS)
def test_changes_of_e57(name: str, tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    more, pose, word = E57_ROWS[name]
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    axes = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), CLOUD.T, strict=True))
    file.write_scan_raw(axes | more, **pose)
    file.close()
    file, asset = pye57.E57(str(tmp_path / "a.e57")), open_asset(tmp_path / "a.e57")
    shown = "colours" in name
    right = file.read_scan(0, ignore_missing_fields=True, colors=shown)
    file.close()
    assert asset.cloud is not None and word in " | ".join(asset.warnings)
    np.testing.assert_allclose(
        asset.cloud.points, np.column_stack([right[a] for a in axes]), atol=1e-5
    )
    colors = asset.cloud.colors
    assert (colors is None) == (not shown)
    if colors is not None:
        assert colors[0].tolist() == [right[f"color{c}"][0] for c in ("Red", "Green", "Blue")]
