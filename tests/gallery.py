"""A page with pictures of generated objects: ``python -m tests.gallery`` writes ``docs/gallery``.

For each family one sheet with a row as made and a row with its parts in colours and its joints half
open.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from model.core.articulated_object import ArticulatedObject
from model.data.procedural.generate import family_names, make
from model.data.procedural.grammar import at_rest
from model.geometry.casting import render

COUNT, SIZE, OPEN = 10, 112, 0.6
OUT = Path(__file__).parents[1] / "docs" / "gallery"
HEAD = f"""# Procedural objects

{COUNT} objects of each family with seed 0, made by `python -m tests.gallery`. Above as made, \
below with the parts in colours and the joints moved by 60 % of their range.
"""


def half_open(obj: ArticulatedObject) -> ArticulatedObject:
    q = {j.name: OPEN for j in obj.tree.joints if j.moves}
    for joint in obj.tree.joints:
        if joint.lower is not None and joint.upper is not None:
            q[joint.name] *= joint.upper if joint.upper >= -joint.lower else joint.lower
    return at_rest(obj, q)


def contact_sheet(family: str) -> Image.Image:
    sheet = Image.new("RGB", (COUNT * SIZE, 2 * SIZE), (246, 246, 246))
    for index in range(COUNT):
        obj = make(family, 0, index).object
        sheet.paste(render(obj, (SIZE, SIZE)), (index * SIZE, 0))
        sheet.paste(render(half_open(obj), (SIZE, SIZE), labels=True), (index * SIZE, SIZE))
    return sheet


if __name__ == "__main__":
    lines = [HEAD]
    for name in family_names():
        contact_sheet(name).save(OUT / f"{name}.jpg", quality=72, optimize=True)
        lines += [f"## {name}", "", f"![{COUNT} objects: {name}]({name}.jpg)", ""]
    (OUT / "README.md").write_text("\n".join(lines))
