"""A page with pictures of generated objects.

Run ``python -m model.data.procedural.gallery --out docs/gallery``: for each family one sheet
with a row as made and a row with its parts in colours and its joints half open.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image

from model.core.articulated_object import ArticulatedObject
from model.data.procedural.generate import family_names, make
from model.data.procedural.grammar import at_rest
from model.geometry.casting import render


def half_open(obj: ArticulatedObject, share: float = 0.6) -> ArticulatedObject:
    """The object with every joint moved by ``share`` of what it can."""
    q = {}
    for joint in obj.tree.joints:
        if joint.limited:
            assert joint.lower is not None and joint.upper is not None
            far = joint.upper if joint.upper >= -joint.lower else joint.lower
            q[joint.name] = share * far
        elif joint.moves:
            q[joint.name] = share
    return at_rest(obj, q)


def contact_sheet(family: str, count: int, seed: int, size: int) -> Image.Image:
    """(2 rows, ``count`` columns) of ``size`` pixels: as made, and open with coloured parts."""
    sheet = Image.new("RGB", (count * size, 2 * size), (246, 246, 246))
    for index in range(count):
        obj = make(family, seed, index).object
        sheet.paste(render(obj, (size, size)), (index * size, 0))
        moved = render(half_open(obj), (size, size), labels=True)
        sheet.paste(moved, (index * size, size))
    return sheet


def write_gallery(
    out: Path, *, count: int = 10, seed: int = 0, size: int = 112, quality: int = 72
) -> Path:
    """Write ``README.md`` and a picture a family.

    Returns:
        The page.
    """
    out.mkdir(parents=True, exist_ok=True)
    rows = [
        "# Procedural objects",
        "",
        f"{count} objects of each family with seed {seed}, made by "
        "`python -m model.data.procedural.gallery --out docs/gallery`. Above as made, below "
        "with the parts in colours and the joints moved by 60 % of their range.",
        "",
    ]
    for family in family_names():
        contact_sheet(family, count, seed, size).save(
            out / f"{family}.jpg", quality=quality, optimize=True
        )
        rows += [f"## {family}", "", f"![{count} objects: {family}]({family}.jpg)", ""]
    page = out / "README.md"
    page.write_text("\n".join(rows))
    return page


def main() -> None:
    """Command line of this module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print(write_gallery(arguments.out, count=arguments.count, seed=arguments.seed))


if __name__ == "__main__":
    main()
