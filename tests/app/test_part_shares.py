"""How much of an object each part is: by area on meshes, by points in clouds."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from app.server.display_tasks import open_asset
from app.server.segmenting import Segmenting
from app.server.tasks import ReadOptions
from model.segmentation.prompts import Click
from sessions.document import Document
from tests.app.segmenter_answers import answer


def shares(asset: Any, labels: np.ndarray) -> dict[int, float]:
    obj: Any = SimpleNamespace(asset=asset, need_asset=lambda: asset, do=lambda c, who: None)
    segmenting = Segmenting(obj)
    answer(segmenting, obj, Document(prompts=(Click((0.0, 0.0, 0.0), 1),)), labels)
    return segmenting.shares


def test_a_finely_meshed_knob_is_a_small_part_of_its_door(tmp_path: Path) -> None:
    door = trimesh.creation.box(extents=(0.6, 0.02, 0.9))
    knob = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    knob.apply_translation((0.2, -0.04, 0))
    path = tmp_path / "door.ply"
    trimesh.util.concatenate([door, knob]).export(path)
    opened = open_asset(path, tmp_path / "workspace", ReadOptions())
    assert opened.display_vertices is not None and opened.display_faces is not None
    held = opened.display_vertices[opened.display_faces].mean(1)
    labels = (np.linalg.norm(held - np.median(held, axis=0), axis=1) < 0.03).astype(np.int16)
    assert (labels == 1).mean() > 0.9
    found = shares(opened, labels)
    assert found[1] == pytest.approx(knob.area / (knob.area + door.area), rel=1e-3)
    assert sum(found.values()) == pytest.approx(1)


def test_points_count_one_each(tmp_path: Path) -> None:
    path = tmp_path / "scan.ply"
    trimesh.PointCloud(np.random.default_rng(0).random((400, 3))).export(path)
    opened = open_asset(path, tmp_path / "workspace", ReadOptions())
    labels = np.zeros(len(opened.element), np.int16)
    labels[:100], labels[100:120] = 2, -1
    assert shares(opened, labels) == pytest.approx({-1: 0.05, 0: 0.7, 2: 0.25})


def test_an_answer_for_faces_that_are_cut_meanwhile_counts_them_alike(tmp_path: Path) -> None:
    path = tmp_path / "box.ply"
    trimesh.creation.box().export(path)
    opened = open_asset(path, tmp_path / "workspace", ReadOptions())
    assert shares(opened, np.array([0, 1, 1, 1], np.int16)) == pytest.approx({0: 0.25, 1: 0.75})
