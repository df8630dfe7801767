"""What an object may be, by its file's name and by what was said last."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from app.viewer.panels.part_list import SHOWN, USUAL, category_guesses, category_in, names_for
from app.viewer.picture.palette import CATEGORIES
from sessions.database import ObjectRecord


def record(number: int, path: str, category: str | None = None, at: str = "") -> ObjectRecord:
    where = Path(path)
    return ObjectRecord(
        number, where, where.stem, None, "todo", 0, 0, category, "you", at, "", None, 0
    )


@pytest.mark.parametrize(
    ("name", "category"),
    [
        ("oven_scan_3", "Oven"),
        ("office_chair_02", "Chair"),
        ("KitchenCabinet", "StorageFurniture"),
        ("scene0011_00_i27_refrigerator", "Refrigerator"),
        ("folding-chair", "FoldingChair"),
        ("washing_machine_v2", "WashingMachine"),
        ("table_with_lamp", "Table"),
        ("boxes", "Box"),
        ("cartoon", None),
        ("desktop", None),
        ("textured_objs", None),
        ("101773", None),
    ],
)
def test_a_name_tells_what_it_is(name: str, category: str | None) -> None:
    assert category_in(name) == category


def test_a_folder_tells_where_the_file_does_not() -> None:
    assert category_guesses(record(1, "/data/Oven/101773/mesh.obj"), ()) == ("Oven",)
    assert category_guesses(record(1, "/data/Oven/fridge.obj"), ()) == ("Refrigerator",)
    assert category_guesses(record(1, "/desk/data/a/b/mesh.obj"), ()) == ()


def test_a_name_that_tells_nothing_takes_what_was_said_last_of_its_series() -> None:
    mine = record(1, "/data/scan_1.ply")
    queue = [
        mine,
        record(2, "/data/scan_2.ply", "Oven", "2026-01-01T10:00:00"),
        replace(
            record(3, "/data/scan_3.ply", "storage furniture", "2026-01-01T09:00:00"), who="me"
        ),
        record(4, "/data/Scan_40.ply", "Safe", "2026-01-01T08:00:00"),
        record(5, "/data/scan_5.ply", "Contraption", "2026-01-01T11:00:00"),
        record(6, "/data/scan_6.ply", None, "2026-01-01T12:00:00"),
    ]
    assert category_guesses(mine, queue, "me") == ("StorageFurniture", "Oven", "Safe")
    assert category_guesses(mine, queue) == ("Oven", "StorageFurniture", "Safe")
    assert category_guesses(record(7, "/data/office_chair.glb"), queue, "me") == ("Chair",)
    assert category_guesses(record(8, "/data/thing.glb"), queue, "me") == (), "no series"
    numbered = [record(9, "/data/7179.obj", "Oven", "2026-01-01T10:00:00")]
    assert category_guesses(record(10, "/data/7296.obj"), numbered, "me") == (), "no name"


def test_many_short_ones_fit_one_row_too() -> None:
    """Each button has a frame: five of them went onto a second row and moved the panel."""
    said = ("Chair", "Laptop", "Kettle", "Lamp", "Safe")
    times = [f"2026-01-01T1{9 - i}:00:00" for i in range(len(said))]
    rows = enumerate(zip(said, times, strict=True), start=2)
    queue = [record(i, f"/data/scan_{i}.ply", category, at) for i, (category, at) in rows]
    assert category_guesses(record(1, "/data/scan_1.ply"), queue) == (
        *"Chair Laptop Kettle Lamp".split(),
    )


def test_name_buttons_fit_the_category() -> None:
    assert names_for(None) == names_for("StorageFurniture") == USUAL
    assert names_for("Chair")[:3] == ("seat", "wheel", "lever")
    assert names_for("Kettle")[:2] == ("lid", "handle")
    for category in CATEGORIES:
        assert len(set(names_for(category))) == SHOWN
