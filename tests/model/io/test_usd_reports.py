"""USD as Isaac, phones, converters and artists write it is read as they mean it, or told."""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.cli.main import main
from model.core.asset import Asset
from model.geometry.sampling import face_colors
from model.io.open_asset import open_asset

pytest.importorskip("pxr")
REPORTS = Path(__file__).parents[4] / "shared" / "public_reports"
CORNERS = "[4,4,4,4,4,4]"
SIDES = "[0,3,2,1, 4,5,6,7, 0,1,5,4, 1,2,6,5, 2,3,7,6, 3,0,4,7]"
RED, BLUE, GREY = (255, 0, 0, 255), (0, 0, 255, 255), (200, 200, 200, 255)


def box(low: tuple[float, ...], high: tuple[float, ...], said: str = "", name: str = "m") -> str:
    (a, b, c), (d, e, f) = low, high
    points = [(x, y, z) for z in (c, f) for x, y in ((a, b), (d, b), (d, e), (a, e))]
    return f"""def Mesh "{name}" (
    prepend apiSchemas = ["PhysicsCollisionAPI","MaterialBindingAPI"]
) {{
    int[] faceVertexCounts = {CORNERS}
    int[] faceVertexIndices = {SIDES}
    point3f[] points = {points}
    uniform token subdivisionScheme = "none"
    {said}
}}
"""


@dataclass
class Made:
    """A cabinet of 0.8 x 0.6 x 1 m whose door hangs on a hinge; each text goes into its place."""

    base: str = ""
    door: str = ""
    panel: str = ""
    hinge: str = ""
    beside: str = ""
    outside: str = ""
    schemas: str = ""
    bodies: str = '"PhysicsRigidBodyAPI"'
    kind: str = "PhysicsRevoluteJoint"
    axis: str = 'uniform token physics:axis = "Z"'
    limits: str = "float physics:lowerLimit = 0\nfloat physics:upperLimit = 90"
    unit: float = 1.0
    kilograms: float = 1.0

    def text(self) -> str:
        u = 1 / self.unit
        applied = f"prepend apiSchemas = [{self.schemas}]" if self.schemas else ""
        low, high = (-0.4 * u, -0.32 * u, 0), (0.4 * u, -0.3 * u, u)
        hang = f"({-0.4 * u}, {-0.3 * u}, {0.5 * u})"
        return f"""#usda 1.0
(
 defaultPrim = "Cabinet"
 metersPerUnit = {self.unit}
 kilogramsPerUnit = {self.kilograms}
 upAxis = "Z"
)
def Xform "Cabinet" {{
def Xform "base" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{
{self.base}
{box((-0.4 * u, -0.3 * u, 0), (0.4 * u, 0.3 * u, u))}
}}
def Xform "door" (prepend apiSchemas = [{self.bodies}]) {{
{self.door}
{box(low, high, self.panel)}
}}
def {self.kind} "hinge" ({applied}) {{
rel physics:body0 = </Cabinet/base>
rel physics:body1 = </Cabinet/door>
{self.axis}
point3f physics:localPos0 = {hang}
point3f physics:localPos1 = {hang}
{self.limits}
{self.hinge}
}}
{self.beside}
}}
{self.outside}
"""


def looks(red: str, blue: str = "", more: str = "") -> str:
    """Materials ``red`` and ``blue``; the inputs of their surfaces."""
    made = "".join(
        f"""def Material "{name}" {{
    token outputs:surface.connect = </Cabinet/Looks/{name}/s.outputs:surface>
    def Shader "s" {{
        uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
        {inputs}
    }}
    {more}
}}
"""
        for name, inputs in (("red", red), ("blue", blue))
    )
    return f'def Scope "Looks" {{\n{made}\n}}'


BOUND = "rel material:binding = </Cabinet/Looks/red>"
TEXTURE = """def Shader "t" {
    uniform token info:id = "UsdUVTexture"
    asset inputs:file = @tex/a.png@
    float2 inputs:st.connect = </Cabinet/Looks/red/move.outputs:result>
    float3 outputs:rgb
    float outputs:r
    float outputs:a
    %s
}
def Shader "move" {
    uniform token info:id = "UsdTransform2d"
    float2 inputs:in.connect = </Cabinet/Looks/red/st.outputs:result>
    float2 outputs:result
    %s
}
def Shader "st" {
    uniform token info:id = "UsdPrimvarReader_float2"
    string inputs:varname = "uv"
    float2 outputs:result
}
"""
OTHER = TEXTURE % ("", "")
for name, new in (('"t"', '"t2"'), ("move", "move2"), ("/st.", "/st2."), ('"st"', '"st2"')):
    OTHER = OTHER.replace(name, new)
OTHER = OTHER.replace('"uv"', '"other"')
PICTURED = "color3f inputs:diffuseColor.connect = </Cabinet/Looks/red/t.outputs:rgb>"
LEFT_BELOW = "(0.25, 0.25)"  # blue; the picture is red elsewhere


def uv(values: str, how: str) -> str:
    return f'texCoord2f[] primvars:uv = {values} ( interpolation = "{how}" )\n{BOUND}'


def colors_of(asset: Asset, part: str | None = None) -> dict[tuple[int, ...], int]:
    assert asset.mesh is not None
    rows = face_colors(asset.mesh)
    if part is not None:
        assert asset.element_part is not None
        rows = rows[asset.element_part == asset.part_names.index(part)]
    found, counts = np.unique(rows, axis=0, return_counts=True)
    return {tuple(c): n for c, n in zip(found.tolist(), counts.tolist(), strict=True)}


def door_colors(**expected: int) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        named = {"red": RED, "blue": BLUE, "grey": GREY}
        assert colors_of(asset, "door") == {named[k]: n for k, n in expected.items()}

    return check


def told(*words: str) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        said = " | ".join(asset.warnings)
        assert all(word in said for word in words), said

    return check


def hung(
    lower: float | None,
    upper: float | None,
    kind: str = "revolute",
    at: tuple[float, ...] = (-0.4, -0.3, 0.5),
) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        assert asset.tree is not None
        (joint,) = asset.tree.joints
        assert joint.type == kind
        assert (joint.lower, joint.upper) == (pytest.approx(lower), pytest.approx(upper))
        np.testing.assert_allclose(joint.origin, at, atol=1e-6)

    return check


def resists(**values: float) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        assert asset.tree is not None
        (joint,) = asset.tree.joints
        assert joint.dynamics is not None
        said = {k: v for k, v in vars(joint.dynamics).items() if v is not None}
        assert said == pytest.approx(values, rel=1e-5)

    return check


def weighs(door: float, **more: tuple[float, ...]) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        found = asset.inertials["link_1"]
        assert found.mass == pytest.approx(door, rel=1e-3)
        np.testing.assert_allclose(found.center, more.get("center", (0, -0.31, 0.5)), atol=1e-5)
        if "diagonal" in more:
            np.testing.assert_allclose(np.diag(found.tensor), more["diagonal"], rtol=1e-3)

    return check


def collides(*faces: int) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        assert [len(shape.faces) for shape in asset.shapes["link_1"]] == list(faces)  # type: ignore[union-attr]

    return check


def both(*checks: Callable[[Asset], None]) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        for each in checks:
            each(asset)

    return check


def parts(*names: str, size: tuple[float, ...] = (0.8, 0.62, 1.0)) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        assert asset.part_names == names and asset.mesh is not None
        np.testing.assert_allclose(np.ptp(asset.mesh.bounds, axis=0), size, atol=1e-6)

    return check


def mimics(multiplier: float, offset: float) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        assert asset.tree is not None
        mimic = asset.tree.by_name["hinge2"].mimic
        assert mimic is not None and mimic.joint == "hinge"
        assert (mimic.multiplier, mimic.offset) == pytest.approx((multiplier, offset))

    return check


def turns_about(axis: tuple[float, ...]) -> Callable[[Asset], None]:
    def check(asset: Asset) -> None:
        assert asset.tree is not None
        np.testing.assert_allclose(asset.tree.joints[0].axis, axis, atol=1e-6)

    return check


def second(schema: str, said: str, kind: str = "PhysicsRevoluteJoint") -> str:
    low, high = (-0.4, 0.3, 0), (0.4, 0.32, 1)
    return f"""def Xform "door2" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{
{box(low, high)}
}}
def {kind} "hinge2" (prepend apiSchemas = ["{schema}"]) {{
rel physics:body0 = </Cabinet/base>
rel physics:body1 = </Cabinet/door2>
uniform token physics:axis = "Z"
point3f physics:localPos0 = (-.4, .3, .5)
point3f physics:localPos1 = (-.4, .3, .5)
{said}
}}
"""


FREE_Z = 'uniform token physics:axis = "X"'
LOCKED = "".join(
    f"float limit:{a}:physics:low = 1\nfloat limit:{a}:physics:high = -1\n"
    for a in ("transX", "transY", "transZ", "rotX", "rotY")
)
D6 = ", ".join(
    f'"PhysicsLimitAPI:{a}"' for a in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")
)
TURNED = "float limit:rotZ:physics:low = -90\nfloat limit:rotZ:physics:high = 0"
GROUND = box((-50, -50, -0.01), (50, 50, 0), name="Ground")
SHELF = box((2, 2, 0), (3, 3, 1), name="shelf")
OPEN = (
    box((0, -0.4, 0), (0.1, -0.35, 0.1), 'uniform token physics:approximation = "convexHull"', "u")
    .replace('"PhysicsCollisionAPI"', "%s")
    .replace("[4,4,4,4,4,4]", "[4,4,4,4,4]")
    .replace(", 3,0,4,7]", "]")
)
MDL = """def Scope "Looks" {
def Material "red" {
    token outputs:mdl:surface.connect = </Cabinet/Looks/red/s.outputs:out>
    def Shader "s" {
        uniform token info:implementationSource = "sourceAsset"
        uniform asset info:mdl:sourceAsset = @OmniPBR.mdl@
        %s
        token outputs:out
    }
}
}"""
MTLX = """def Scope "Looks" {
def Material "red" {
    token outputs:mtlx:surface.connect = </Cabinet/Looks/red/s.outputs:out>
    def Shader "s" {
        uniform token info:id = "ND_standard_surface_surfaceshader"
        %s
        token outputs:out
    }
    def Shader "i" {
        uniform token info:id = "ND_image_color3"
        asset inputs:file = @tex/a.png@
        float2 inputs:texcoord.connect = </Cabinet/Looks/red/c.outputs:out>
        color3f outputs:out
    }
    def Shader "c" {
        uniform token info:id = "ND_geompropvalue_vector2"
        string inputs:geomprop = "uv"
        float2 outputs:out
    }
}
}"""
ANY = 'uniform token elementType = "face"\nuniform token familyName = "materialBind"'


def subset(name: str, faces: str, look: str) -> str:
    return (
        f'def GeomSubset "{name}" (prepend apiSchemas = ["MaterialBindingAPI"]) {{\n{ANY}\n'
        f"int[] indices = {faces}\nrel material:binding = </Cabinet/Looks/{look}>\n}}\n"
    )


def shown(values: str, how: str, indices: str = "") -> str:
    said = f'color3f[] primvars:displayColor = {values} ( interpolation = "{how}" )\n'
    return said + (f"int[] primvars:displayColor:indices = {indices}" if indices else "")


R, B = "(1,0,0)", "(0,0,1)"
MADE: dict[str, tuple[Made, Callable[[Asset], None]]] = {
    # Looks
    "constant": (Made(panel=shown(f"[{R}]", "constant")), door_colors(red=12)),
    "uniform": (
        Made(panel=shown(f"[{R},{R},{B},{B},{B},{B}]", "uniform")),
        door_colors(red=4, blue=8),
    ),
    "indexed": (
        Made(panel=shown(f"[{R},{B}]", "uniform", "[0,0,0,1,1,1]")),
        door_colors(red=6, blue=6),
    ),
    "vertex": (Made(panel=shown(f"[{','.join([B] * 8)}]", "vertex")), door_colors(blue=12)),
    "face-varying": (
        Made(panel=shown(f"[{','.join([R] * 4 + [B] * 20)}]", "faceVarying")),
        door_colors(red=2, blue=10),
    ),
    "inherited": (Made(door=shown(f"[{R}]", "constant")), door_colors(red=12)),
    "misfit": (
        Made(panel=shown(f"[{R},{B}]", "uniform")),
        both(told("displayColor"), door_colors(grey=12)),
    ),
    "subsets": (
        Made(
            panel=subset("a", "[0,1,2]", "red") + subset("b", "[3]", "blue"),
            beside=looks(
                f"color3f inputs:diffuseColor = {R}", f"color3f inputs:diffuseColor = {B}"
            ),
        ),
        door_colors(red=6, blue=2, grey=4),
    ),
    "interface": (
        Made(
            panel=BOUND,
            beside=looks(
                "color3f inputs:diffuseColor.connect = </Cabinet/Looks/red.inputs:c>",
                more=f"color3f inputs:c = {R}",
            ),
        ),
        door_colors(red=12),
    ),
    "bound above": (
        Made(
            door=BOUND,
            bodies='"PhysicsRigidBodyAPI","MaterialBindingAPI"',
            beside=looks(f"color3f inputs:diffuseColor = {R}"),
        ),
        door_colors(red=12),
    ),
    "texture right side up": (
        Made(
            panel=uv(f"[{', '.join([LEFT_BELOW] * 3 + ['(0.25,0.75)'] * 3)}]", "uniform"),
            beside=looks(PICTURED, more=TEXTURE % ("", "")),
        ),
        door_colors(blue=6, red=6),
    ),
    "texture by corners": (
        Made(
            panel=uv(f"[{', '.join([LEFT_BELOW] * 4 + ['(0.75,0.25)'] * 20)}]", "faceVarying"),
            beside=looks(PICTURED, more=TEXTURE % ("", "")),
        ),
        door_colors(blue=2, red=10),
    ),
    "texture moved": (
        Made(
            panel=uv("[(0.5,-0.5)]", "constant"),
            beside=looks(
                PICTURED,
                more=TEXTURE % ("", "float inputs:rotation = 90\nfloat2 inputs:scale = (0.5, 0.5)"),
            ),
        ),
        both(door_colors(blue=12), lambda a: _is(a.warnings, ())),
    ),
    "two sets of coordinates": (
        Made(
            panel=uv("[(0.25,0.25)]", "constant")
            + '\ntexCoord2f[] primvars:other = [(0.75,0.75)] ( interpolation = "constant" )\n'
            + subset("b", "[3]", "blue"),
            beside=looks(PICTURED, PICTURED.replace("/t.", "/t2."), TEXTURE % ("", "") + OTHER),
        ),
        both(door_colors(red=2, blue=10), lambda a: _is(a.warnings, ())),
    ),
    "look of MDL": (
        Made(
            panel=BOUND,
            beside=MDL % "color3f inputs:diffuse_color_constant = (1,1,1)\n"
            "color3f inputs:diffuse_tint = (1,0,0)\nfloat inputs:opacity_constant = 0.1",
        ),
        both(door_colors(red=12), lambda a: _is(a.warnings, ())),
    ),
    "texture of MDL, tinted": (
        Made(
            panel=uv(f"[{LEFT_BELOW}]", "constant").replace("primvars:uv", "primvars:st"),
            beside=MDL % "asset inputs:diffuse_texture = @tex/a.png@\n"
            "color3f inputs:diffuse_tint = (1,1,0)\nasset inputs:ORM_texture = @tex/a.png@",
        ),
        both(lambda a: _is(colors_of(a, "door"), {(0, 0, 0, 255): 12}), told("roughness map")),
    ),
    "texture of another machine, moved": (
        Made(
            panel=uv(f"[{LEFT_BELOW}]", "constant").replace("primvars:uv", "primvars:st"),
            beside=MDL % "asset inputs:diffuse_texture = @C:/me/tex/own.png@\n"
            "float2 inputs:texture_scale = (2, 1)",
        ),
        both(door_colors(blue=12), told("material 'red': what moves its texture isn't read")),
    ),
    "missing texture of MDL": (
        Made(
            panel=uv(f"[{LEFT_BELOW}]", "constant"),
            beside=MDL % "asset inputs:diffuse_texture = @tex/b.png@\n"
            f"color3f inputs:diffuse_color_constant = {B}\nfloat inputs:opacity_constant = 0.4\n"
            "bool inputs:enable_opacity = 1",
        ),
        both(lambda a: _is(colors_of(a, "door"), {(0, 0, 255, 102): 12}), told("tex/b.png")),
    ),
    "unread look of MDL": (
        Made(panel=BOUND, beside=MDL % "color3f inputs:paint = (1,1,1)"),
        told("material 'red': its colour isn't read"),
    ),
    "look of MaterialX": (
        Made(
            panel=BOUND, beside=MTLX % f"float inputs:base = 0.5\ncolor3f inputs:base_color = {R}"
        ),
        lambda a: _is(colors_of(a, "door"), {(188, 0, 0, 255): 12}),
    ),
    "texture of MaterialX": (
        Made(
            panel=uv(f"[{LEFT_BELOW}]", "constant"),
            beside=MTLX % "color3f inputs:base_color.connect = </Cabinet/Looks/red/i.outputs:out>",
        ),
        both(door_colors(blue=12), lambda a: _is(a.warnings, ())),
    ),
    "texture times colour": (
        Made(
            panel=uv("[(0.75,0.75)]", "constant"),
            beside=looks(PICTURED, more=TEXTURE % ("float4 inputs:scale = (0,1,1,1)", "")),
        ),
        lambda a: _is(colors_of(a, "door"), {(0, 0, 0, 255): 12}),
    ),
    "texture outside": (
        Made(
            panel=uv(f"[{LEFT_BELOW}]", "constant"),
            beside=looks(PICTURED, more=(TEXTURE % ("", "")).replace("tex/a.png", "../a.png")),
        ),
        told("../a.png", "stage's folder"),
    ),
    "no coordinates": (
        Made(panel=BOUND, beside=looks(PICTURED, more=TEXTURE % ("", ""))),
        both(
            told("coordinates 'uv' of a texture are missing"),
            lambda a: _is(len(colors_of(a, "door")), 1),
        ),
    ),
    "opacity": (
        Made(panel=shown(f"[{R}]", "constant") + "float[] primvars:displayOpacity = [0.4]"),
        lambda a: _is(colors_of(a, "door"), {(255, 0, 0, 102): 12}),
    ),
    "glass": (
        Made(
            panel=BOUND,
            beside=looks(f"color3f inputs:diffuseColor = {R}\nfloat inputs:opacity = 0.4"),
        ),
        lambda a: _is(colors_of(a, "door"), {(255, 0, 0, 102): 12}),
    ),
    "light": (
        Made(panel=BOUND, beside=looks(f"color3f inputs:emissiveColor = {R}")),
        told("left out of its materials: emission"),
    ),
    "unknown node": (
        Made(
            panel=BOUND,
            beside=looks(
                PICTURED,
                more=(TEXTURE % ("", ""))
                .replace("inputs:file", "inputs:other")
                .replace("UsdUV", "My"),
            ),
        ),
        told("material 'red': its colour isn't read"),
    ),
    # Geometry
    "shapes of other kinds": (
        Made(door='def Cylinder_1 "k" {}\ndef Plane "l" {}'),
        both(parts("base", "door"), told("Cylinder_1 (1)", "Plane (1)")),
    ),
    "prototypes": (
        Made(
            door='def PointInstancer "p" {\nrel prototypes = [</Cabinet/door/p/s>]\n'
            'def Sphere "s" {\ndouble radius = 3\n}\n}\ndef Points "q" {}'
        ),
        both(parts("base", "door"), told("ignored: PointInstancer (1), Points (1)")),
    ),
    # What is stated and not read
    "stiffness": (
        Made(
            schemas='"PhysicsDriveAPI:angular"', hinge="float drive:angular:physics:stiffness = 3"
        ),
        told("ignored: drive:angular:physics:stiffness (1)"),
    ),
    "hole": (Made(panel="int[] holeIndices = [0]"), told("holeIndices (1)")),
    "schema": (
        Made(
            hinge="float foo:strength = 3\nfloat mjc:armature = 2",
            schemas='"FooJointAPI", "PhysicsDriveAPI:angular"',
        ),
        told("schema FooJointAPI (1)", "mjc:armature (1)"),
    ),
    "animation": (
        Made(
            door="double3 xformOp:translate.timeSamples = {3: (0, 0, 0), 7: (0, 1, 0)}\n"
            'uniform token[] xformOpOrder = ["xformOp:translate"]\n'
            "float physics:mass.timeSamples = {3: 2, 7: 9}",
            panel="color3f[] primvars:displayColor.timeSamples = {3: [(1,0,0)], 7: [(0,0,1)]}",
            limits="float physics:lowerLimit.timeSamples = {1: -30}\n"
            "float physics:upperLimit.timeSamples = {1: 0}",
        ),
        both(
            told("of 3 values over time the earliest count"),
            parts("base", "door"),
            door_colors(red=12),
            hung(-np.pi / 6, 0),
            weighs(2),
        ),
    ),
    # Joints
    "a turn and more": (
        Made(limits="float physics:lowerLimit = -360\nfloat physics:upperLimit = 720"),
        hung(-2 * np.pi, 4 * np.pi),
    ),
    "lower alone": (
        Made(limits="float physics:lowerLimit = -30"),
        both(told("one limit"), hung(-np.pi / 6, 11 * np.pi / 6)),
    ),
    "slide with upper alone": (
        Made(kind="PhysicsPrismaticJoint", limits="float physics:upperLimit = 0.2"),
        both(told("one limit"), hung(-0.8, 0.2, "prismatic")),
    ),
    "no limits": (Made(limits=""), hung(None, None, "continuous")),
    "free about two": (
        Made(
            kind="PhysicsJoint",
            schemas=D6,
            axis="",
            limits=LOCKED.replace("rotY:physics:high = -1", "rotY:physics:high = 5") + TURNED,
        ),
        told("ignored: PhysicsJoint (1)"),
    ),
    "free about one": (
        Made(kind="PhysicsJoint", schemas=D6, axis="", limits=LOCKED + TURNED),
        both(hung(-np.pi / 2, 0), turns_about((0, 0, 1)), lambda a: _is(a.warnings, ())),
    ),
    "free along one, as one limit is missing": (
        Made(
            kind="PhysicsJoint",
            schemas=D6 + ', "PhysicsDriveAPI:transX"',
            axis="",
            limits=LOCKED.replace("float limit:transX:physics:high = -1", "")
            + TURNED.replace("= 0", "= -90"),
            hinge="float drive:transX:physics:damping = 3",
        ),
        both(hung(1, 2, "prismatic"), turns_about((1, 0, 0)), resists(damping=3)),
    ),
    "free in two beside a hinge": (
        Made(beside=second("PhysicsLimitAPI:rotX", LOCKED.replace("rotY", "any"), "PhysicsJoint")),
        told("'hinge2' of type PhysicsJoint: read as fixed, free along rotY, rotZ"),
    ),
    "switched off": (
        Made(hinge="bool physics:jointEnabled = 0"),
        told("ignored: PhysicsRevoluteJoint (1)"),
    ),
    "mirrored in x": (
        Made(
            door="double3 xformOp:scale = (-1,-1,-1)\n"
            'uniform token[] xformOpOrder = ["xformOp:scale"]'
        ),
        lambda a: _is(a.tree is not None and a.tree.joints[0].axis, (0, 0, 1)),
    ),
    "drive in centimetres and grams": (
        Made(
            unit=0.01,
            kilograms=0.001,
            schemas='"PhysicsDriveAPI:angular", "PhysxJointAPI"',
            hinge="float drive:angular:physics:maxForce = 1e8\n"
            "float drive:angular:physics:damping = 1745329.2\n"
            "float physxJoint:jointFriction = 1e7\nfloat physxJoint:maxJointVelocity = 180",
        ),
        both(hung(0, np.pi / 2), resists(effort=10, damping=10, friction=1, velocity=np.pi)),
    ),
    "linear drive": (
        Made(
            unit=0.01,
            kind="PhysicsPrismaticJoint",
            schemas='"PhysicsDriveAPI:linear"',
            hinge="float drive:linear:physics:maxForce = 1000\n"
            "float drive:linear:physics:damping = 5",
        ),
        resists(effort=10, damping=5),
    ),
    "newton's mimic": (
        Made(
            beside=second(
                "NewtonMimicAPI",
                "rel newton:mimicJoint = </Cabinet/hinge>\n"
                "float newton:mimicCoef0 = 90\nfloat newton:mimicCoef1 = -0.5",
            )
        ),
        mimics(-0.5, np.pi / 2),
    ),
    "mujoco's mimic": (
        Made(
            beside=second(
                "MjcEqualityJointAPI",
                "rel mjc:target = </Cabinet/hinge>\ndouble mjc:coef0 = 0.5\n"
                "double mjc:coef1 = 2\ndouble mjc:coef2 = 3",
            )
        ),
        both(mimics(2, 0.5), told("ignored: mjc:coef2 (1)")),
    ),
    "drive by acceleration": (
        Made(
            schemas='"PhysicsDriveAPI:angular"',
            hinge='uniform token drive:angular:physics:type = "acceleration"\n'
            "float drive:angular:physics:damping = 1",
        ),
        told("damping by acceleration"),
    ),
    # Bodies
    "density": (Made(door="float physics:density = 500"), weighs(8)),
    "density in centimetres": (
        Made(unit=0.01, door="float physics:density = 0.0005"),
        weighs(8, diagonal=(0.66693, 1.0936, 0.42693)),
    ),
    "density of a material": (
        Made(
            panel="rel material:binding:physics = </Cabinet/wood>",
            beside='def Material "wood" (prepend apiSchemas = ["PhysicsMaterialAPI"]) {\n'
            "float physics:density = 700\n}",
        ),
        weighs(11.2),
    ),
    "mass before density": (
        Made(door="float physics:density = 500\nfloat physics:mass = 2"),
        weighs(2),
    ),
    "mass of a shape": (Made(panel="float physics:mass = 4"), weighs(4)),
    "density of a shape before its body's": (
        Made(door="float physics:density = 500", panel="float physics:density = 1000"),
        weighs(16),
    ),
    "mass": (Made(door="float physics:mass = 3500", kilograms=0.001), weighs(3.5)),
    "centre and mass": (
        Made(door="float physics:mass = 2\npoint3f physics:centerOfMass = (0.1, 0, 0.2)"),
        weighs(2, center=(0.1, 0, 0.2)),
    ),
    "inertia without a body's": (
        Made(door="float physics:mass = 12\nfloat3 physics:diagonalInertia = (1, 1, 9)"),
        both(told("no body's"), weighs(12, diagonal=(1.0004, 1.6404, 0.6404))),
    ),
    "hull of a collider": (
        Made(door=OPEN % '"PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"'),
        both(collides(12, 12), lambda a: _is(a.warnings, ())),
    ),
    "box of a collider": (
        Made(
            door=(OPEN % '"PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"').replace(
                "convexHull", "boundingCube"
            )
        ),
        both(collides(10, 12), told("ignored: physics:approximation (1)")),
    ),
    "off body": (
        Made(
            door='def Xform "knob" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {\n'
            f"bool physics:rigidBodyEnabled = 0\n"
            f"{box((0.3, -0.4, 0.4), (0.35, -0.32, 0.5), name='k')}\n}}"
        ),
        both(parts("base", "door", size=(0.8, 0.7, 1.0)), door_colors(grey=24)),
    ),
    "ground within": (
        Made(beside=GROUND),
        both(parts("base", "door"), told("surroundings left out: Ground (1)")),
    ),
    "static beside bodies": (
        Made(beside=SHELF),
        both(parts("base", "door"), told("surroundings left out: shelf (1)")),
    ),
    "look in a file of MaterialX": (
        Made(
            panel=BOUND,
            beside='def "Looks" ( prepend references = @tex/look.mtlx@</MaterialX> ) {}',
        ),
        both(told("not read: 'tex/look.mtlx' and what it holds"), door_colors(grey=12)),
    ),
    "ground outside": (
        Made(outside=GROUND),
        both(parts("base", "door"), told("surroundings left out: Ground (1)")),
    ),
    "beside the default prim": (
        Made(outside=f'def Scope "protos" {{\n{SHELF}\n{box((0, 0, 0), (1, 1, 1), name="b")}\n}}'),
        both(parts("base", "door"), told("surroundings left out: protos (2)")),
    ),
    "empty mesh": (
        Made(door='def Mesh "e" {}'),
        both(parts("base", "door"), told("ignored: Mesh (1)")),
    ),
    "lost payload": (
        Made(beside='def Xform "x" ( prepend payload = @./far/x.usd@ ) {}'),
        told("far/x.usd"),
    ),
    "known": (Made(), lambda a: _is(a.warnings, ())),
}


def _is(found: object, expected: object) -> None:
    assert found == expected


ROWS = {  # what a stage says: the inputs that are read without a remark, and those with one
    "colours of a mesh, of any interpolation, inherited": (
        "constant uniform indexed vertex face-varying inherited opacity",
        "misfit",
    ),
    "UsdPreviewSurface: colour, opacity, texture, UsdTransform2d; GeomSubsets": (
        "subsets interface bound_above glass texture_right_side_up texture_by_corners "
        "texture_moved two_sets_of_coordinates texture_times_colour",
        "texture_outside no_coordinates unknown_node",
    ),
    "other maps, emission": ("", "light texture_of_MDL,_tinted"),
    "MDL: colour, tint and texture of OmniPBR and its like": (
        "look_of_MDL",
        "texture_of_another_machine,_moved missing_texture_of_MDL unread_look_of_MDL",
    ),
    "MaterialX: colour and texture of standard surface and OpenPBR": (
        "look_of_MaterialX texture_of_MaterialX",
        "look_in_a_file_of_MaterialX",
    ),
    "values over time: the earliest": ("", "animation"),
    "instancers, curves, points, other shapes, empty meshes, holes": (
        "",
        "shapes_of_other_kinds prototypes empty_mesh hole",
    ),
    "surroundings: what isn't below the prim that holds all joined bodies, or is static": (
        "",
        "ground_within ground_outside beside_the_default_prim static_beside_bodies",
    ),
    "revolute and prismatic joints, also with one limit or none": (
        "known a_turn_and_more no_limits",
        "lower_alone slide_with_upper_alone switched_off mirrored_in_x",
    ),
    "joints without a type (D6): with one free axis; others are fixed": (
        "free_about_one",
        "free_about_two free_along_one,_as_one_limit_is_missing free_in_two_beside_a_hinge",
    ),
    "damping, friction, effort and velocity of joints": (
        "drive_in_centimetres_and_grams linear_drive",
        "drive_by_acceleration stiffness",
    ),
    "mimics of PhysX, Newton and MuJoCo": ("newton's_mimic", "mujoco's_mimic"),
    "masses, densities of bodies, shapes and materials, centres, inertia": (
        "density density_in_centimetres density_of_a_material mass_before_density "
        "mass_of_a_shape density_of_a_shape_before_its_body's mass centre_and_mass",
        "inertia_without_a_body's",
    ),
    "flags that switch bodies, colliders and joints off": ("off_body", "switched_off"),
    "meshes and hulls of colliders": ("hull_of_a_collider", "box_of_a_collider"),
    "missing files, schemas and values of physics that no reader knows": (
        "",
        "lost_payload schema",
    ),
}


def test_each_input_has_a_row_of_the_document() -> None:
    inputs = [name for row in ROWS.values() for names in row for name in names.split()]
    assert {name.replace("_", " ") for name in inputs} == set(MADE)


DOORS = "".join(
    f"""def Xform "door_{side}" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{
{box((low, -0.32, 0), (low + 0.4, -0.3, 1))}
}}
def PhysicsRevoluteJoint "hinge_{side}" {{
rel physics:body0 = %s
rel physics:body1 = <%s/door_{side}>
uniform token physics:axis = "Z"
point3f physics:localPos0 = ({2 * low + 0.4}, -0.3, 0)
point3f physics:localPos1 = ({2 * low + 0.4}, -0.3, 0)
float physics:lowerLimit = 0
float physics:upperLimit = 90
}}
"""
    for side, low in (("left", -0.4), ("right", 0.0))
)


def static(name: str) -> str:
    """A cabinet without a body, with two doors."""
    case = f'def Xform "body" {{\n{box((-0.4, -0.3, 0), (0.4, 0.3, 1))}\n}}\n'
    doors = DOORS % ((f"</{name}/body>", f"/{name}") * 2)
    return f'def Xform "{name}" {{\n{case}{doors}\n}}\n'


HEAD = '#usda 1.0\n(\n upAxis = "Z"\n metersPerUnit = 1\n)\n'
WORLD = 'def Scope "none" {}\n' + static("A").replace("rel physics:body0 = </A/body>\n", "")
INSTANCED = (
    static("P").replace("def", "class", 1)
    + 'def Xform "A" (\n instanceable = true\n prepend references = </P>\n) {}\n'
)
PLAIN = f"""def Xform "A" {{
def Xform "base" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{
{box((0, 0, 0), (1, 1, 1), name="geo")}
}}
def Xform "door" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{
{box((0, -0.1, 0), (1, 0, 1), name="geo")}
{box((0, -0.2, 0), (0.1, -0.1, 0.1), name="geo2")}
}}
}}
"""
STAGES: dict[str, tuple[str, tuple[str, ...], int, str]] = {  # parts, joints, what is told
    "a body joints name": (static("A"), ("body", "door_left", "door_right"), 2, ""),
    "joints to the world": (WORLD, ("A", "door_left", "door_right"), 2, ""),
    "joints to the world, of two": (
        WORLD + static("B").replace("rel physics:body0 = </B/body>\n", ""),
        ("m", "door_left", "door_right") * 2,
        0,
        "PhysicsRevoluteJoint (4)",
    ),
    "a loose thing, a table": (
        f'def Xform "W" {{\n{static("A").replace("/A", "/W/A")}{SHELF}'
        f'def Xform "cup" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{\n{SHELF}}}\n}}',
        ("body", "door_left", "door_right"),
        2,
        "surroundings left out: shelf (1), cup (1)",
    ),
    "beside the default prim": (
        HEAD.replace("(", '(\n defaultPrim = "A"', 1) + PLAIN + SHELF,
        ("base", "door", "shelf"),
        0,
        "beside the default prim 'A' stands: shelf (1)",
    ),
    "and a ground": (
        static("A") + GROUND,
        ("body", "door_left", "door_right"),
        2,
        "surroundings left out: Ground (1)",
    ),
    "a ground within": (
        static("A").removesuffix("}\n") + f"{GROUND}}}",
        ("body", "door_left", "door_right"),
        2,
        "Ground is 100 x 100 m",
    ),
    "in an instance": (INSTANCED, ("body", "door_left", "door_right"), 2, ""),
    "two of them": (
        static("A") + static("B"),
        ("m", "door_left", "door_right") * 2,
        0,
        "PhysicsRevoluteJoint (4)",
    ),
    "no joint": (PLAIN, ("base", "door"), 0, ""),
}


@pytest.mark.parametrize("name", STAGES)
def test_bodies_that_stand_and_parts_named_after_bodies(name: str, tmp_path: Path) -> None:
    text, names, joints, said = STAGES[name]
    (tmp_path / "a.usda").write_text(text if text.startswith("#") else HEAD + text)
    asset = open_asset(tmp_path / "a.usda")
    assert asset.part_names == names
    assert len(asset.tree.joints if asset.tree else ()) == joints
    assert said in " ".join(asset.warnings) and (said or not asset.warnings)


def _picture(folder: Path) -> None:
    """Blue left below, red elsewhere; a file of MaterialX."""
    image = Image.new("RGB", (8, 8), RED[:3])
    image.paste(BLUE[:3], (0, 4, 4, 8))
    for place in (folder / "tex" / "a.png", folder.parent / "a.png", folder / "own.png"):
        place.parent.mkdir(exist_ok=True)
        image.save(place)
    (folder / "tex" / "look.mtlx").write_text('<materialx version="1.38"/>')


@pytest.mark.parametrize("name", MADE)
def test_variants_are_read_or_told(name: str, tmp_path: Path) -> None:
    made, check = MADE[name]
    folder = tmp_path / "stage"
    folder.mkdir()
    _picture(folder)
    (folder / "a.usda").write_text(made.text())
    asset, key = open_asset(folder / "a.usda"), name.replace(" ", "_")
    check(asset)
    rows = [row for row in ROWS.values() if key in f"{row[0]} {row[1]}".split()]
    assert all(bool(asset.warnings) == (key in told.split()) for _, told in rows)


def report(file: str) -> Asset:
    path = REPORTS / file
    if not path.exists():
        pytest.skip("needs the shared public reports")
    return open_asset(path)


FOUR_BARS = ["j1", "j2", "j3"]
REPORTED: dict[str, Callable[[Asset], None]] = {
    "usd_cm_drive/cabinet.usda": resists(effort=10, damping=10),
    "usd_body_disabled/cabinet.usda": both(
        parts("base", "door", size=(0.8, 0.67, 1)), door_colors(grey=24)
    ),
    "usd_mass_only/cabinet.usda": weighs(3.5),
    "usd_geomsubset/cabinet.usda": lambda a: _is(colors_of(a), {RED: 6, BLUE: 6}),
    "usd_newton_mimic/cabinet.usda": mimics(-1, 0),
    "usd_collision_off/cabinet.usda": lambda a: _is(
        {k: len(v) for k, v in a.shapes.items()}, {"link_1": 1}
    ),
    "usd_mirrored_body/cabinet.usda": both(parts("base", "door"), hung(0, np.pi / 2)),
    "usdz_textured/scan.usdz": lambda a: _is(colors_of(a), {(200, 30, 30, 255): 960}),
    "usd_limits_inf/inf.usda": hung(None, None, "continuous"),
    "usd_limits_inf/one_sided.usda": both(hung(0, 2 * np.pi), told("one limit")),
    "usd_missing_reference/cabinet.usda": told("parts/door.usd"),
    "usd_isaac_instanced/over.usda": both(parts("base", "door"), lambda a: _is(a.warnings, ())),
    "usd_isaac_instanced/def_invisible.usda": parts("base", "door"),
    "usd_isaac_instanced/def_visible.usda": both(
        parts("base", "door"),
        lambda a: _is({k: len(v) for k, v in a.shapes.items()}, {"link_0": 1, "link_1": 1}),
        told("surroundings left out: visuals (2)"),
    ),
    "usd_static_base/cab.usda": parts("base", "door_left", "door_right", size=(0.6, 0.42, 0.8)),
    "usd_loop_excluded/bars.usda": both(
        told("'j4' closes a loop"),
        lambda a: _is([j.name for j in a.tree.joints], FOUR_BARS),  # type: ignore[union-attr]
    ),
    "usd_com_unauthored/cab.usda": weighs(
        3.5, center=(0, -0.21, 0.4), diagonal=(0.19, 0.29, 0.105)
    ),
    "usd_multi_turn/valve.usda": hung(-2 * np.pi, 4 * np.pi, at=(0, -0.2, 0.5)),
    "usd_model_unread/cab.usda": both(
        parts("base", "door", size=(0.6, 0.42, 0.8)), told("PointInstancer", "BasisCurves")
    ),
    "usd_ground_plane/cab.usda": both(
        parts("base", "door", size=(0.6, 0.42, 0.8)), told("surroundings left out: GroundPlane (1)")
    ),
}


@pytest.mark.parametrize("file", REPORTED)
def test_public_reports_are_right(file: str) -> None:
    REPORTED[file](report(file))


def test_an_export_keeps_names_and_colours(tmp_path: Path) -> None:
    path = REPORTS / "roundtrip_names" / "cabinet.urdf"
    if not path.exists():
        pytest.skip("needs the shared public reports")
    assert main(["export", str(path), "--format", "usd", "--out", str(tmp_path)]) == 0
    asset = open_asset(tmp_path / "object.usdc")
    assert asset.part_names == ("base", "door") and asset.warnings == ()
    assert colors_of(asset, "base") == {RED: 12, (0, 255, 0, 255): 12}
    assert colors_of(asset, "door") == {BLUE: 12, (255, 255, 0, 128): 12}


def test_a_package_has_its_textures_inside(tmp_path: Path) -> None:
    sdf, tools = (import_module(f"pxr.{n}") for n in ("Sdf", "UsdUtils"))

    _picture(tmp_path)
    made, check = MADE["texture right side up"]
    (tmp_path / "a.usda").write_text(made.text())
    packed = tmp_path / "packed" / "a.usdz"
    packed.parent.mkdir()
    tools.CreateNewUsdzPackage(sdf.AssetPath(str(tmp_path / "a.usda")), str(packed))
    assert any(n.endswith(".png") for n in zipfile.ZipFile(packed).namelist())
    check(open_asset(packed))
