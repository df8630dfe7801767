"""OpenUSD with UsdPhysics, for Isaac Sim, Omniverse and whatever reads the standard schema.

Links are prims beside each other below the default prim, each where its URDF link frame sits
(``model.io.urdf.writer``). Joints hold an axis that is x of both their frames. Angles are degrees,
as the schema has it. What the schema lacks (joint friction, mimic joints) is written as PhysX's
applied schemas, which other programs ignore. Affordances are lines below their links, which
SimReady calls grasp vectors where a gripper pinches (requirement GSP.001).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Affordance, ArticulatedObject, Inertial
from model.core.files import free_name
from model.core.geometry import Material, Mesh, quaternion_wxyz, x_onto
from model.core.joint import JOINT_KINDS, Joint, Mimic
from model.core.packages import require
from model.core.progress import Progress
from model.core.shapes import Primitive, Shape
from model.core.textures import ImageFile, SurfaceMaps, encode, to_linear
from model.geometry.sampling import corner_normals
from model.io.export.formats import FileExporter
from model.io.urdf.writer import direct_mimics, link_origins, rounded
from model.physics.affordances import find_affordances
from model.physics.inertia import read_materials
from model.physics.part_mesh import part_mesh
from model.physics.simulation_values import Physics

FILE = "object.usdc"
TEXTURES = "textures"
FRICTION = "physxJoint:jointFriction"
NAME_KEY = "artiworld:name"
"""Custom data of links and joints: their own names, which USD's identifiers may not hold."""

_LINE = 0.002
"""Width in metres of the line that shows an affordance."""
AFFORDANCE = "artiworld:affordance"
"""Begins the attributes of an affordance: kind, joint, center, normal, closing, width."""
GRASP_VECTOR = "grasp_identifier"
"""Begins the names of SimReady's grasp vectors."""

FloatArray = npt.NDArray[np.float64]
_ROUGHNESS = 0.6  # default of materials without a value


def identifier(name: str, taken: set[str]) -> str:
    """A USD identifier like ``name``, which is added to those ``taken``."""
    plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in name) or "_"
    free = free_name(f"_{plain}" if plain[0].isdigit() else plain, taken)
    taken.add(free)
    return free


class UsdExporter(FileExporter):
    """``object.usdc`` and ``textures/``."""

    name = "usd"

    def __init__(self, file: str = FILE) -> None:
        """``file``: name of the written file."""
        self.file = file

    def write(
        self, obj: ArticulatedObject, folder: Path, physics: Physics, progress: Progress
    ) -> tuple[Path, ...]:
        """See :class:`~model.io.export.formats.FileExporter`."""
        return _Writer(obj, folder / self.file, physics).write(progress)


class _Writer:
    def __init__(self, obj: ArticulatedObject, path: Path, physics: Physics) -> None:
        self.obj, self.path, self.folder, self.physics = obj, path, path.parent, physics
        self.materials = read_materials()
        (
            self._Gf,
            self._Sdf,
            self._Usd,
            self._UsdGeom,
            self._UsdPhysics,
            self._UsdShade,
            self._Vt,
        ) = (
            require(f"pxr.{name}", "artiworld[usd]", "USD")
            for name in ("Gf", "Sdf", "Usd", "UsdGeom", "UsdPhysics", "UsdShade", "Vt")
        )
        self.origins = link_origins(obj.tree)
        self.files: list[Path] = []
        self.looks: dict[tuple[Any, ...], Any] = {}
        self.names: dict[str, set[str]] = {}

    def write(self, progress: Progress) -> tuple[Path, ...]:
        stage = self.stage = self._Usd.Stage.CreateInMemory()
        self._UsdGeom.SetStageUpAxis(stage, self._UsdGeom.Tokens.z)
        self._UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        self._UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        self.top = f"/{self._identifier('/', self.obj.name or 'object')}"
        root = self._UsdGeom.Xform.Define(stage, self.top).GetPrim()
        stage.SetDefaultPrim(root)
        self._Usd.ModelAPI(root).SetKind("component")
        self._UsdPhysics.ArticulationRootAPI.Apply(root)
        self._label(root, "class", self.obj.category or self.obj.name or "object")
        parts = {p.link: p for p in self.obj.parts}
        self.links: dict[str, Any] = {}
        for i, link in enumerate(self.obj.tree.order):
            progress(i / len(self.obj.tree.order), f"writing {link}")
            prim = self.links[link] = self._link(link)
            if link in parts:
                part = parts[link]
                if part.name:
                    self._label(prim, "class", part.name)
                made_of = self.materials.name_of(part, self.obj.category)
                self._visual(prim, part_mesh(part), link, made_of)
            for number, shape in enumerate(self.physics.collision.get(link, ())):
                self._collision(prim, shape, number, link)
        for number, affordance in enumerate(find_affordances(self.obj, self.physics.collision), 1):
            self._affordance(affordance, number)
        self._joints()
        stage.GetRootLayer().Export(str(self.path))
        progress(1.0, "written")
        return (self.path, *dict.fromkeys(self.files))

    def _identifier(self, scope: str, name: str) -> str:
        return identifier(name, self.names.setdefault(scope, {"joints", "Looks"}))

    # Links

    def _link(self, link: str) -> Any:
        path = f"{self.top}/{self._identifier(self.top, link)}"
        xform = self._UsdGeom.Xform.Define(self.stage, path)
        xform.AddTranslateOp().Set(self._Gf.Vec3d(*rounded(self.origins[link])))
        prim = xform.GetPrim()
        prim.SetCustomDataByKey(NAME_KEY, link)
        self._UsdPhysics.RigidBodyAPI.Apply(prim)
        inertial = self.physics.inertials.get(link)
        if inertial is not None:
            self._mass(prim, inertial, self.origins[link])
        return prim

    def _label(self, prim: Any, taxonomy: str, text: str) -> None:
        """A label for synthetic data; by its name, as older usd-core has no SemanticsLabelsAPI."""
        prim.AddAppliedSchema(f"SemanticsLabelsAPI:{taxonomy}")
        types = self._Sdf.ValueTypeNames
        attribute = prim.CreateAttribute(f"semantics:labels:{taxonomy}", types.TokenArray, False)
        attribute.Set([text.strip().lower()])

    def _mass(self, prim: Any, inertial: Inertial, origin: FloatArray) -> None:
        values, axes = np.linalg.eigh(inertial.exact_tensor)
        axes *= np.sign(axes[np.abs(axes).argmax(0), range(3)])
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        api = self._UsdPhysics.MassAPI.Apply(prim)
        api.CreateMassAttr(float(inertial.mass))
        api.CreateCenterOfMassAttr(self._vec3f(inertial.center - origin))
        api.CreateDiagonalInertiaAttr(self._Gf.Vec3f(*values.tolist()))
        api.CreatePrincipalAxesAttr(self._Gf.Quatf(*quaternion_wxyz(axes)))

    def _vec3f(self, values: npt.ArrayLike) -> Any:
        return self._Gf.Vec3f(*rounded(values))

    # Looks

    def _visual(self, prim: Any, mesh: Mesh, link: str, made_of: str) -> None:
        made = self._mesh(
            f"{prim.GetPath()}/visual", mesh.vertices - self.origins[link], mesh.faces
        )
        if mesh.uv is not None:
            st = self._UsdGeom.PrimvarsAPI(made).CreatePrimvar(
                "st", self._Sdf.ValueTypeNames.TexCoord2fArray, self._UsdGeom.Tokens.vertex
            )
            st.Set(self._Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(mesh.uv, np.float32)))
        shown = () if mesh.vertex_colors is None else self._colors(made, mesh.vertex_colors)
        binding = self._UsdShade.MaterialBindingAPI
        used = np.unique(mesh.face_material).tolist()
        if len(used) == 1:
            look = self._look(mesh.materials[used[0]], shown, made_of)
            binding.Apply(made.GetPrim()).Bind(look)
            return
        for index in used:
            faces = np.flatnonzero(mesh.face_material == index).astype(np.int32)
            subset = binding.Apply(made.GetPrim()).CreateMaterialBindSubset(
                f"subset_{index}", self._Vt.IntArray.FromNumpy(faces)
            )
            look = self._look(mesh.materials[index], shown, made_of)
            binding.Apply(subset.GetPrim()).Bind(look)

    def _colors(self, made: Any, rgba: npt.NDArray[np.uint8]) -> tuple[str, ...]:
        """Write a mesh' own colours; the names of what materials read of them."""
        linear = np.ascontiguousarray(to_linear(rgba[:, :3] / 255.0), np.float32)
        vertex = self._UsdGeom.Tokens.vertex
        made.CreateDisplayColorPrimvar(vertex).Set(self._Vt.Vec3fArray.FromNumpy(linear))
        if (rgba[:, 3] == 255).all():
            return ("displayColor",)
        alpha = np.ascontiguousarray(rgba[:, 3] / 255.0, np.float32)
        made.CreateDisplayOpacityPrimvar(vertex).Set(self._Vt.FloatArray.FromNumpy(alpha))
        return ("displayColor", "displayOpacity")

    def _mesh(self, path: str, vertices: FloatArray, faces: npt.NDArray[np.int32]) -> Any:
        made = self._UsdGeom.Mesh.Define(self.stage, path)
        points = np.ascontiguousarray(vertices, np.float32)
        made.CreatePointsAttr(self._Vt.Vec3fArray.FromNumpy(points))
        counts = np.full(len(faces), 3, np.int32)
        made.CreateFaceVertexCountsAttr(self._Vt.IntArray.FromNumpy(counts))
        indices = np.ascontiguousarray(faces.reshape(-1), np.int32)
        made.CreateFaceVertexIndicesAttr(self._Vt.IntArray.FromNumpy(indices))
        made.CreateSubdivisionSchemeAttr(self._UsdGeom.Tokens.none)
        extent = np.ascontiguousarray(np.stack([points.min(axis=0), points.max(axis=0)]))
        made.CreateExtentAttr(self._Vt.Vec3fArray.FromNumpy(extent))
        which, normals = corner_normals(Mesh(vertices, faces))
        shading = self._UsdGeom.PrimvarsAPI(made).CreatePrimvar(
            "normals", self._Sdf.ValueTypeNames.Normal3fArray, self._UsdGeom.Tokens.faceVarying
        )
        shading.Set(self._Vt.Vec3fArray.FromNumpy(normals))
        shading.SetIndices(self._Vt.IntArray.FromNumpy(which.reshape(-1)))
        return made

    def _look(self, material: Material, shown: tuple[str, ...], made_of: str) -> Any:
        """The material; ``shown`` of the mesh stands for its colour where it has no texture.

        ``made_of``: its label, such as "wood".
        """
        picture = None
        if material.texture is not None:
            picture = self._picture(ImageFile(*encode(material.texture)))
        shown = shown if picture is None else ()
        color_of = material.base_color if not shown else (255, 255, 255, 255)
        key = (
            color_of,
            picture,
            material.metallic,
            material.roughness,
            material.maps,
            shown,
            made_of,
        )
        if key in self.looks:
            return self.looks[key]
        types, shade = self._Sdf.ValueTypeNames, self._UsdShade
        path = f"{self.top}/Looks/{self._identifier('Looks', material.name)}"
        made = self.looks[key] = shade.Material.Define(self.stage, path)
        self._label(made.GetPrim(), "material", made_of)
        surface = shade.Shader.Define(self.stage, f"{path}/surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        color = surface.CreateInput("diffuseColor", types.Color3f)
        color.Set(self._Gf.Vec3f(*to_linear(np.asarray(color_of[:3]) / 255.0).tolist()))
        opacity = surface.CreateInput("opacity", types.Float)
        opacity.Set(color_of[3] / 255.0)
        roughness = _ROUGHNESS if material.roughness is None else material.roughness
        surface.CreateInput("roughness", types.Float).Set(roughness)
        if material.metallic is not None:
            surface.CreateInput("metallic", types.Float).Set(material.metallic)
        if picture is not None:
            texture = self._texture(path, "texture", picture, "sRGB")
            color.ConnectToSource(texture.CreateOutput("rgb", types.Float3))
        self._maps(path, surface, material.maps)
        if "displayColor" in shown:
            color.ConnectToSource(self._primvar(path, "displayColor", "float3", types.Float3))
        if "displayOpacity" in shown:
            opacity.ConnectToSource(self._primvar(path, "displayOpacity", "float", types.Float))
        output = surface.CreateOutput("surface", types.Token)
        made.CreateSurfaceOutput().ConnectToSource(output)
        return made

    def _maps(self, path: str, surface: Any, maps: SurfaceMaps) -> None:
        """Texture values are multiplied by the scale and shifted by the bias, in linear space."""
        types = self._Sdf.ValueTypeNames
        if maps.normal is not None:
            picture, bump = self._picture(maps.normal), maps.normal_scale
            texture = self._texture(path, "normal_map", picture, "raw")
            self._scaled(texture, (2 * bump, 2 * bump, 2.0, 1.0), (-bump, -bump, -1.0, 0.0))
            normal = surface.CreateInput("normal", types.Normal3f)
            normal.ConnectToSource(texture.CreateOutput("rgb", types.Float3))
        if any(maps.emission):
            glow = surface.CreateInput("emissiveColor", types.Color3f)
            glow.Set(self._vec3f(maps.emission))
            if maps.emissive is not None:
                picture = self._picture(maps.emissive)
                texture = self._texture(path, "emissive_map", picture, "sRGB")
                self._scaled(texture, (*maps.emission, 1.0), (0.0,) * 4)
                glow.ConnectToSource(texture.CreateOutput("rgb", types.Float3))
        if maps.occlusion is not None:
            picture, strength = self._picture(maps.occlusion), maps.occlusion_strength
            texture = self._texture(path, "occlusion_map", picture, "raw")
            self._scaled(texture, (strength,) * 4, (1.0 - strength,) * 4)
            occlusion = surface.CreateInput("occlusion", types.Float)
            occlusion.ConnectToSource(texture.CreateOutput("r", types.Float))

    def _texture(self, path: str, name: str, picture: str, color_space: str) -> Any:
        types = self._Sdf.ValueTypeNames
        texture = self._UsdShade.Shader.Define(self.stage, f"{path}/{name}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", types.Asset).Set(self._Sdf.AssetPath(f"./{picture}"))
        texture.CreateInput("wrapS", types.Token).Set("repeat")
        texture.CreateInput("wrapT", types.Token).Set("repeat")
        texture.CreateInput("sourceColorSpace", types.Token).Set(color_space)
        st = self._primvar(path, "st", "float2", types.Float2)
        texture.CreateInput("st", types.Float2).ConnectToSource(st)
        return texture

    def _scaled(self, texture: Any, scale: Sequence[float], bias: Sequence[float]) -> None:
        for name, values in (("scale", scale), ("bias", bias)):
            made = texture.CreateInput(name, self._Sdf.ValueTypeNames.Float4)
            made.Set(self._Gf.Vec4f(*values))

    def _primvar(self, path: str, name: str, kind: str, type: Any) -> Any:
        """A primvar reader."""
        reader = self._UsdShade.Shader.Define(self.stage, f"{path}/{name}")
        reader.CreateIdAttr(f"UsdPrimvarReader_{kind}")
        reader.CreateInput("varname", self._Sdf.ValueTypeNames.String).Set(name)
        return reader.CreateOutput("result", type)

    def _picture(self, image: ImageFile) -> str:
        digest = hashlib.sha256(image.data).hexdigest()[:12]
        name = f"{TEXTURES}/texture_{digest}{image.suffix}"
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(image.data)
        self.files.append(path)
        return name

    # Collision

    def _collision(self, link_prim: Any, shape: Shape, number: int, link: str) -> None:
        path = f"{link_prim.GetPath()}/collision_{number}"
        if isinstance(shape, Primitive):
            made = self._primitive(path, shape, self.origins[link])
        else:
            made = self._mesh(path, shape.vertices - self.origins[link], shape.faces)
            api = self._UsdPhysics.MeshCollisionAPI.Apply(made.GetPrim())
            api.CreateApproximationAttr(self._UsdPhysics.Tokens.convexHull)
        made.CreatePurposeAttr(self._UsdGeom.Tokens.guide)
        self._UsdPhysics.CollisionAPI.Apply(made.GetPrim())

    def _primitive(self, path: str, shape: Primitive, origin: FloatArray) -> Any:
        pose = shape.object_from_shape
        kind = "Cube" if shape.kind == "box" else shape.kind.capitalize()
        made = getattr(self._UsdGeom, kind).Define(self.stage, path)
        made.AddTranslateOp().Set(self._Gf.Vec3d(*rounded(pose[:3, 3] - origin)))
        made.AddOrientOp().Set(self._Gf.Quatf(*quaternion_wxyz(pose)))
        if shape.kind == "box":
            made.CreateSizeAttr(1.0)
            made.AddScaleOp().Set(self._vec3f(shape.sizes))
            return made
        sizes = rounded(shape.sizes)
        made.CreateRadiusAttr(sizes[0])
        if shape.kind != "sphere":
            made.CreateHeightAttr(sizes[1])
            made.CreateAxisAttr(self._UsdGeom.Tokens.z)
        return made

    # Affordances

    def _affordance(self, affordance: Affordance, number: int) -> None:
        """A line across what is pinched, or along the approach to what is pushed or hooked."""
        pinch = affordance.kind in ("grasp", "turn")
        name = f"{GRASP_VECTOR if pinch else 'affordance'}_{number:02}"
        made = self._UsdGeom.BasisCurves.Define(
            self.stage, f"{self.links[affordance.link].GetPath()}/{name}"
        )
        center = np.asarray(affordance.center)
        along = np.asarray(affordance.closing if pinch else affordance.normal)
        half = (affordance.width / 2 + 0.01) * along
        points = np.stack([center - half, center + half]).astype(np.float32)
        made.CreatePointsAttr(self._Vt.Vec3fArray.FromNumpy(points))
        made.CreateCurveVertexCountsAttr(self._Vt.IntArray([2]))
        made.CreateTypeAttr(self._UsdGeom.Tokens.linear)
        made.CreateWidthsAttr(self._Vt.FloatArray([_LINE]))
        made.SetWidthsInterpolation(self._UsdGeom.Tokens.constant)
        extent = self._UsdGeom.Curves.ComputeExtent(made.GetPointsAttr().Get(), [_LINE])
        made.CreateExtentAttr(extent)
        made.CreatePurposeAttr(self._UsdGeom.Tokens.guide)
        types = self._Sdf.ValueTypeNames
        for key, kind, value in (
            ("kind", types.Token, affordance.kind),
            ("joint", types.String, affordance.joint),
            ("center", types.Point3f, self._vec3f(affordance.center)),
            ("normal", types.Vector3f, self._vec3f(affordance.normal)),
            ("closing", types.Vector3f, self._vec3f(affordance.closing)),
            ("width", types.Float, affordance.width),
        ):
            made.GetPrim().CreateAttribute(f"{AFFORDANCE}:{key}", kind, True).Set(value)

    # Joints

    def _joints(self) -> None:
        scope = f"{self.top}/joints"
        self._UsdGeom.Scope.Define(self.stage, scope)
        prims: dict[str, Any] = {}
        for joint in self.obj.tree.joints:
            path = f"{scope}/{self._identifier('joints', joint.name)}"
            prims[joint.name] = self._joint(path, joint)
        for name, mimic in direct_mimics(self.obj.tree).items():
            self._mimic(prims[name], self.obj.tree.by_name[name], mimic, prims[mimic.joint])
        if self.physics.fixed_base:
            path = f"{scope}/{self._identifier('joints', 'fixed_to_world')}"
            made = self._UsdPhysics.FixedJoint.Define(self.stage, path)
            made.CreateBody1Rel().SetTargets([self.links[self.obj.tree.root].GetPath()])
        for a, b in self.physics.overlapping:
            api = self._UsdPhysics.FilteredPairsAPI.Apply(self.links[a])
            api.CreateFilteredPairsRel().AddTarget(self.links[b].GetPath())

    def _joint(self, path: str, joint: Joint) -> Any:
        schema = JOINT_KINDS[joint.type].usd.removeprefix("Physics")
        made = getattr(self._UsdPhysics, schema).Define(self.stage, path)
        prim = made.GetPrim()
        prim.SetCustomDataByKey(NAME_KEY, joint.name)
        made.CreateBody0Rel().SetTargets([self.links[joint.parent].GetPath()])
        made.CreateBody1Rel().SetTargets([self.links[joint.child].GetPath()])
        offset = self.origins[joint.child] - self.origins[joint.parent]
        turn = x_onto(np.asarray(rounded(joint.axis))) if joint.moves else np.eye(3)
        made.CreateLocalPos0Attr(self._vec3f(offset))
        made.CreateLocalPos1Attr(self._vec3f(np.zeros(3)))
        made.CreateLocalRot0Attr(self._Gf.Quatf(*quaternion_wxyz(turn)))
        made.CreateLocalRot1Attr(self._Gf.Quatf(*quaternion_wxyz(turn)))
        if joint.moves:
            made.CreateAxisAttr(self._UsdPhysics.Tokens.x)
            unit = 180.0 / math.pi if joint.rotates else 1.0
            if joint.limited:
                made.CreateLowerLimitAttr((joint.lower or 0.0) * unit)
                made.CreateUpperLimitAttr((joint.upper or 0.0) * unit)
            self._drive(prim, joint, unit)
        return prim

    def _drive(self, prim: Any, joint: Joint, unit: float) -> None:
        dynamics = self.physics.dynamics.get(joint.name)
        if dynamics is None:
            return
        api = self._UsdPhysics.DriveAPI.Apply(prim, "angular" if joint.rotates else "linear")
        api.CreateTypeAttr(self._UsdPhysics.Tokens.force)
        api.CreateStiffnessAttr(0.0)
        api.CreateDampingAttr(dynamics.damping / unit)
        api.CreateMaxForceAttr(dynamics.effort)
        self._extra(
            prim,
            "PhysxJointAPI",
            [
                (FRICTION, dynamics.friction),
                ("physxJoint:maxJointVelocity", dynamics.velocity * unit),
            ],
        )

    def _extra(self, prim: Any, schema: str, values: Sequence[tuple[str, float]]) -> None:
        """A schema of PhysX, which usd-core doesn't know, by its names."""
        prim.AddAppliedSchema(schema)
        for name, value in values:
            prim.CreateAttribute(name, self._Sdf.ValueTypeNames.Float, False).Set(value)

    def _mimic(self, prim: Any, joint: Joint, mimic: Mimic, leader: Any) -> None:
        """PhysX: q + gearing * q(leader) + offset = 0, in degrees or metres."""
        (axis, mine_unit), (theirs, their_unit) = (
            ("rotX", 180.0 / math.pi) if j.rotates else ("transX", 1.0)
            for j in (joint, self.obj.tree.by_name[mimic.joint])
        )
        base = f"physxMimicJoint:{axis}"
        self._extra(
            prim,
            f"PhysxMimicJointAPI:{axis}",
            [
                (f"{base}:gearing", -mimic.multiplier * mine_unit / their_unit),
                (f"{base}:offset", -mimic.offset * mine_unit),
            ],
        )
        token = self._Sdf.ValueTypeNames.Token
        prim.CreateAttribute(f"{base}:referenceJointAxis", token, False).Set(theirs)
        prim.CreateRelationship(f"{base}:referenceJoint", False).SetTargets([leader.GetPath()])
