"""SDF as Drake takes it, whose reader is libsdformat, Gazebo's own."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Any

from model.core.articulated_object import ArticulatedObject
from model.io.assets.reload import object_from_links
from model.io.export.sdf import screws_of, sdf_joint_names
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
    names, screws = sdf_joint_names(obj.tree), screws_of(obj)
    context = plant.CreateDefaultContext()
    problems: list[str] = []
    for q in settings:
        for name, value in obj.tree.joint_values(q).items():
            if name in screws.slides:
                continue
            joint = plant.GetJointByName(names[name], model)
            if name in screws.pitches:
                joint.set_translation(context, screws.pitches[name] * value / (2 * math.pi))
            elif obj.tree.by_name[name].rotates:
                joint.set_angle(context, value)
            else:
                joint.set_translation(context, value)
        links = [link for link in obj.tree.links if link not in screws.slides.values()]
        frames = {link: plant.GetBodyByName(link, model) for link in links}
        root = frames[obj.tree.root].EvalPoseInWorld(context).inverse()
        seen = {
            link: (root @ body.EvalPoseInWorld(context)).GetAsMatrix4()
            for link, body in frames.items()
        }
        expected = {k: v for k, v in object_from_links(obj, q).items() if k in frames}
        problems += pose_problems("Drake", expected, seen)
    return list(dict.fromkeys(problems))
