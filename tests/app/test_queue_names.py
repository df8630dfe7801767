from __future__ import annotations

from pathlib import Path

from app.server.names import clipped, queue_names
from sessions.database import ObjectRecord


def record(number: int, path: str) -> ObjectRecord:
    where = Path(path)
    return ObjectRecord(number, where, where.stem, None, "todo", 0, 0, None, "", "", "", None, 0)


def named(*paths: str) -> list[str]:
    return list(queue_names([record(i, path) for i, path in enumerate(paths)]).values())


def test_objects_of_one_name_are_told_apart():
    assert named("/a/cloud.ply", "/b/chair.ply") == ["cloud", "chair"]
    assert named("/a/cloud.ply", "/a/cloud.xyz") == ["cloud.ply", "cloud.xyz"]
    assert named("/a/cloud.ply", "/b/cloud.ply") == ["a/cloud", "b/cloud"]
    assert named("/a/cloud.ply", "/a/cloud.xyz", "/b/cloud.ply") == [
        "a/cloud.ply",
        "a/cloud.xyz",
        "b/cloud.ply",
    ]
    assert named("/a/x/cloud.ply", "/b/x/cloud.ply") == ["a/x/cloud", "b/x/cloud"]


def test_long_names_lose_their_middle():
    assert clipped("cabinet", 22) == "cabinet"
    short = clipped("scene0011_00_i27_refrigerator", 22)
    assert short == "scene00…7_refrigerator" and len(short) == 22
