"""The demo objects that ship in ``static_assets/examples``.

Run ``python -m model.data.procedural.examples --out static_assets/examples``. The same seed
gives the same files. Beside each object lie good clicks (``<name>.prompts.json``) and, in
``truth/``, what the clicks should lead to.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.geometry import Mesh, merged
from model.data.procedural.families import (
    decor,
    devices,
    furniture,
    kitchen,
    seating,
    vessels,
    washing,
)
from model.data.procedural.grammar import ProceduralObject
from model.data.procedural.materials import Palette, metal, plain, wood
from model.data.procedural.modules import Opening
from model.data.simulated.depth_camera import ScanSettings, View, simulate_scan, visible_elements
from model.geometry.sampling import sample_surface
from model.io.open_asset import open_asset
from model.io.write import mesh_to_glb, write_cloud
from model.segmentation.prompts import Click, Prompts, next_part_click
from model.segmentation.registry import load_segmenter

FORMAT = 1


@dataclass(frozen=True)
class Example:
    """One demo object: how it is made, and how it was scanned where it is a scan."""

    make: Callable[[np.random.Generator], ProceduralObject]
    scan: ScanSettings | None = None


def cabinet(rng: np.random.Generator) -> ProceduralObject:
    """A sideboard: two doors, three drawers between them, on tapered legs."""
    w, h, leg = 1.28, 0.62, 0.15
    x = w / 2
    third = 0.21
    cells = [furniture.Cell("door", Opening(-x, -third, leg, leg + h))]
    cuts = np.linspace(leg, leg + h, 4)
    cells += [
        furniture.Cell("drawer", Opening(-third, third, float(a), float(b)))
        for a, b in itertools.pairwise(cuts)
    ]
    left = furniture.Cupboard(
        (w, 0.44, h), (*cells, furniture.Cell("door", Opening(third, x, leg, leg + h))), wall=0.019,
        gap=0.003, leg="taper", leg_height=leg, front="shaker", handle="bar", handle_length=0.13,
        shelves=1, overhang=0.03, swing=1.92,
    )  # fmt: skip
    dark = plain("shadow", (52, 44, 38))
    palette = Palette(wood("walnut"), wood("oak"), metal("brass"), metal("steel"), dark)
    return furniture.cupboard(left, palette, rng, mirrored=True)


def laptop(rng: np.random.Generator) -> ProceduralObject:
    """A laptop, opened by 110 degrees."""
    shell = plain("alloy", (176, 179, 185))
    return devices.build_laptop((0.325, 0.228, 0.0145), rng, shell, open_angle=1.92, screen=1)


def oven(rng: np.random.Generator) -> ProceduralObject:
    """A range with six knobs."""
    enamel = plain("enamel", (226, 226, 222))
    body = plain("body", (112, 116, 122))
    palette = Palette(body, enamel, metal("dark"), metal("steel"), plain("panel", (70, 72, 78)))
    spec = kitchen.OvenSpec(
        knobs=6, knob_style=1, burners=4, drawer=True, knob_limits=(0.0, 4.71), gap=0.008
    )
    return kitchen.build_oven(spec, palette, rng)


def refrigerator(rng: np.random.Generator) -> ProceduralObject:
    """French doors over a freezer drawer."""
    steel = plain("steel_paint", (172, 178, 186))
    palette = Palette(steel, steel, metal("dark"), metal("steel"), plain("panel", (36, 37, 40)))
    return kitchen.build_refrigerator("french", (0.9, 0.62, 1.74), palette, rng, gap=0.009)


EXAMPLES: Mapping[str, Example] = {
    "cabinet": Example(cabinet),
    "laptop": Example(laptop),
    "office_chair": Example(lambda rng: seating.office_chair(rng, casters=True, back=True)),
    "kettle": Example(vessels.kettle),
    "washing_machine": Example(washing.washing_machine),
    "oven_scan": Example(
        oven,
        ScanSettings((View(-0.35, 0.32, 1.9), View(0.4, 0.38, 2.0)), 220_000, depth_noise=0.0005),
    ),
    "refrigerator_scan": Example(
        refrigerator,
        ScanSettings((View(-0.5, 0.12, 2.9), View(0.35, 0.2, 2.8)), 150_000, depth_noise=0.0003),
    ),
    "desk_lamp": Example(decor.lamp),
}
"""Name -> how it is made. New ones go to the end: a name's place decides its random numbers."""


def write_examples(
    out: Path, seed: int = 0, names: tuple[str, ...] = tuple(EXAMPLES)
) -> tuple[Path, ...]:
    """Write the demo objects.

    Args:
        names: which of :data:`EXAMPLES`.

    Returns:
        The objects' files (without prompts and truth).
    """
    (out / "truth").mkdir(parents=True, exist_ok=True)
    written = []
    for name in names:
        example = EXAMPLES[name]
        rng = np.random.default_rng([seed, list(EXAMPLES).index(name)])
        made = example.make(rng)
        obj = made.object
        if example.scan is None:
            path = out / f"{name}.glb"
            whole, owner = joined(obj)
            path.write_bytes(mesh_to_glb(whole, y_up=True))
            labels = _labels_as_read(path, whole, owner)
            views = (View(-0.6, 0.4), View(0.6, 0.4), View(-0.3, -0.25), View(0.3, 1.2))
        else:
            path = out / f"{name}.ply"
            scan = simulate_scan(obj, example.scan, rng)
            write_cloud(scan.cloud, path)
            labels, views = scan.part, example.scan.views
        content = prompts(made, views, hidden=example.scan is None, spread=5 if example.scan else 1)
        _write_json(out / f"{name}.prompts.json", content)
        _write_json(out / "truth" / f"{name}.json", truth(obj, labels))
        written.append(path)
    return tuple(written)


MORE_CLICKS = 40


def completed(
    path: Path, data: dict[str, Any], labels: npt.NDArray[np.int32], most: int = MORE_CLICKS
) -> dict[str, Any]:
    """``data`` (prompts of a mesh) with what a person would click next, until all faces are right.

    Args:
        path: the object. labels: (F,) true part of each face. most: clicks to add.

    Returns:
        The prompts with the clicks up to the best answer.
    """
    asset = open_asset(path)
    assert asset.mesh is not None
    session = load_segmenter().encode(asset)
    centers, areas = asset.element_centers, asset.mesh.face_areas
    clicks = [Click(tuple(c["position"]), c["part"], c["positive"]) for c in data["clicks"]]
    given = kept = len(clicks)
    best = np.inf
    for _ in range(most + 1):
        answer = session.segment(Prompts(tuple(clicks))).labels
        wrong = float(areas[answer != labels].sum())
        if wrong < best:
            kept, best = len(clicks), wrong
        found = next_part_click(centers, labels, answer)
        if found is None:
            break
        x, y, z = _rounded(centers[found[0]], 5)
        clicks.append(Click((x, y, z), found[1], True, found[0]))
    added = [
        {"position": list(c.position), "part": c.part, "positive": True, "element": c.element}
        for c in clicks[given:kept]
    ]
    return data | {"clicks": [*data["clicks"], *added]}


def complete_prompts(out: Path, names: tuple[str, ...] = tuple(EXAMPLES)) -> None:
    """:func:`completed` for the meshes among what :func:`write_examples` wrote to ``out``."""
    for path in (out / f"{name}.glb" for name in names if EXAMPLES[name].scan is None):
        name = path.stem
        prompts_file, truth_file = out / f"{name}.prompts.json", out / "truth" / f"{name}.json"
        runs = json.loads(truth_file.read_text())["runs"]
        labels = np.concatenate([np.full(n, part, np.int32) for part, n in runs])
        _write_json(prompts_file, completed(path, json.loads(prompts_file.read_text()), labels))


def joined(obj: ArticulatedObject) -> tuple[Mesh, npt.NDArray[np.int32]]:
    """All parts as one mesh, and the (F,) part index of each face."""
    meshes = [p.mesh for p in obj.parts if p.mesh is not None]
    owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
    return merged(meshes), owner.astype(np.int32)


def _labels_as_read(path: Path, whole: Mesh, owner: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(E,) part of each face in the order in which a reader gives them."""
    from scipy.spatial import KDTree

    centers = open_asset(path).element_centers
    return owner[KDTree(whole.triangles.mean(axis=1)).query(centers)[1]]


def truth(obj: ArticulatedObject, labels: npt.NDArray[np.int32]) -> dict[str, object]:
    """Joints, and the part of each element as runs of [part, length]; -1 is a stray point."""
    starts = np.flatnonzero(np.r_[True, labels[1:] != labels[:-1]])
    lengths = np.diff(np.r_[starts, len(labels)])
    joints = [
        {
            "name": j.name,
            "type": j.type,
            "parent": j.parent,
            "child": j.child,
            "axis": _rounded(j.axis, 6),
            "origin": _rounded(j.origin, 5),
            "lower": None if j.lower is None else round(j.lower, 5),
            "upper": None if j.upper is None else round(j.upper, 5),
        }
        for j in obj.tree.joints
    ]
    return {
        "format": FORMAT,
        "category": obj.category,
        "links": list(obj.tree.links),
        "parts": [{"id": i, "link": p.link, "name": p.name} for i, p in enumerate(obj.parts)],
        "joints": joints,
        "runs": [[int(labels[a]), int(n)] for a, n in zip(starts, lengths, strict=True)],
    }


def prompts(
    made: ProceduralObject, views: tuple[View, ...], *, hidden: bool, spread: int = 1
) -> dict[str, object]:
    """Clicks that a person would make: the middle of each part, and of its handle or rim.

    Args:
        views: from where the person looks.
        hidden: also click solids that can't be seen (a drawer's box), as one does on a mesh after
            hiding what is before them.
        spread: clicks on each of the two largest solids of a part; help where seams are faint.
    """
    from scipy.spatial import KDTree

    obj = made.object
    seen = visible_elements(obj, views)
    inside = _inside(made) if hidden else {}
    clicks: list[dict[str, object]] = []
    named = []
    for number, part in enumerate(obj.parts):
        mine = np.flatnonzero(seen.part == number)
        names = np.array(made.piece_names[part.link])
        spots = {}
        if len(mine):
            piece = names[made.pieces[part.link][seen.face[mine]]]
            for kind in _worth_clicking(piece, 4 if number == 0 else 2):
                spots[kind] = seen.points[mine[piece == kind]]
        for kind, points in inside.get(number, {}).items():
            spots.setdefault(kind, points)
        for rank, (kind, points) in enumerate(spots.items()):
            # Far from other parts; in a scan, whose seams are faint, also from other solids.
            rest = seen.part != number
            if not hidden:
                piece = names[made.pieces[part.link][seen.face[mine]]]
                rest[mine] = piece != kind
            away = KDTree(seen.points[rest])
            for place in _deep_points(points, away.query(points)[0], spread if rank < 2 else 1):
                clicks.append({"position": _rounded(place, 5), "part": number, "positive": True})
        if number and spots:
            named.append({"id": number, "name": part.name})
    clicks.sort(key=lambda c: c["part"] == 0)  # type: ignore[return-value]
    return {"format": FORMAT, "category": obj.category, "parts": named, "clicks": clicks}


def _inside(made: ProceduralObject) -> dict[int, dict[str, npt.NDArray[np.float64]]]:
    """Part -> kind of solid -> points on it, for kinds that make up a twentieth of the part."""
    out: dict[int, dict[str, npt.NDArray[np.float64]]] = {}
    for number, part in enumerate(made.object.parts):
        assert part.mesh is not None
        cloud, face = sample_surface(part.mesh, 2000, np.random.default_rng(number))
        kinds = np.array(made.piece_names[part.link])[made.pieces[part.link][face]]
        names = _worth_clicking(kinds, 6, 0.05)
        out[number] = {k: cloud.points[kinds == k].astype(np.float64) for k in names}
    return out


def _deep_points(
    points: npt.NDArray[np.float64], depth: npt.NDArray[np.float64], count: int
) -> list[npt.NDArray[np.float64]]:
    """The point farthest from other parts, then ones as deep and far from those before."""
    found = [points[int(np.argmax(depth))]]
    while len(found) < count:
        apart = np.min([np.linalg.norm(points - f, axis=1) for f in found], axis=0)
        found.append(points[int(np.argmax(np.minimum(apart, 2 * depth)))])
    return found


def _worth_clicking(kinds: npt.NDArray[np.str_], most: int, least: float = 0.02) -> list[str]:
    """The kinds of solid that cover most, each at least the share ``least``."""
    names, counts = np.unique(kinds, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return [str(names[i]) for i in order[:most] if counts[i] >= least * len(kinds)]


def _rounded(values: npt.ArrayLike, digits: int) -> list[float]:
    return [round(float(v), digits) + 0.0 for v in np.asarray(values)]


def _write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, separators=(",", ":")) + "\n")


def main() -> None:
    """Command line of this module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for path in write_examples(arguments.out, arguments.seed):
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
    complete_prompts(arguments.out)


if __name__ == "__main__":
    main()
