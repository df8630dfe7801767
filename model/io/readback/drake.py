"""SDF as Drake takes it, whose reader is libsdformat, Gazebo's own."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Any

from model.core.articulated_object import ArticulatedObject
from model.io.assets.reload import object_from_links
from model.io.export.sdf import sdf_joint_names, sdf_tree
from model.io.readback.poses import pose_problems


def drake_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    """Problems when Drake parses the file and its joints are set."""
    plant_module: Any = import_module("pydrake.multibody.plant")
    parsing: Any = import_module("pydrake.multibody.parsing")
    plant = plant_module.MultibodyPlant(0.0)
    try:
        (model,) = parsing.Parser(plant).AddModels(str(path))
        plant.Finalize()
    except (RuntimeError, ValueError) as error:
        return [f"Drake can't load {path.name}: {' '.join(str(error).split())[:300]}"]
    tree, pitches = sdf_tree(obj)
    names = sdf_joint_names(tree)
    context = plant.CreateDefaultContext()
    problems: list[str] = []
    for q in settings:
        for name, value in tree.joint_values(q).items():
            joint = plant.GetJointByName(names[name], model)
            if name in pitches:
                joint.set_translation(context, pitches[name] * value / (2 * math.pi))
            elif tree.by_name[name].rotates:
                joint.set_angle(context, value)
            else:
                joint.set_translation(context, value)
        frames = {link: plant.GetBodyByName(link, model) for link in tree.links}
        root = frames[obj.tree.root].EvalPoseInWorld(context).inverse()
        seen = {
            link: (root @ body.EvalPoseInWorld(context)).GetAsMatrix4()
            for link, body in frames.items()
        }
        expected = {k: v for k, v in object_from_links(obj, q).items() if k in frames}
        problems += pose_problems("Drake", expected, seen)
    return list(dict.fromkeys(problems))
