"""Labelled rooms for the benchmark: a PLY with its labels beside it."""

from pathlib import Path

import numpy as np
import pytest

from model.core.errors import InputFileError
from model.core.geometry import PointCloud
from model.evaluation.segmentation_clicks import room_objects
from model.io.write import write_cloud


def room(folder: Path, name: str, labels: int = 300) -> None:
    rng = np.random.default_rng(0)
    write_cloud(PointCloud(rng.random((300, 3)).astype(np.float32)), folder / f"{name}.ply")
    instance = np.repeat([-1, 0, 1], 100)[:labels]
    kind = np.repeat([-1, 2, 5], 100)[:labels]  # a cabinet and a sofa
    np.savez(folder / f"{name}_labels.npz", instance=instance, segment20=kind)


def test_every_labelled_scan_is_found(tmp_path: Path) -> None:
    room(tmp_path, "kitchen")
    room(tmp_path, "hall")
    (tmp_path / "lonely.ply").write_bytes((tmp_path / "hall.ply").read_bytes())
    found = list(room_objects(tmp_path))
    assert [item.name for item in found] == ["hall", "kitchen"]
    assert found[0].parts == (1,) and not found[0].whole
    assert np.bincount(found[0].labels).tolist() == [100, 100, 100]


def test_labels_that_do_not_fit_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no labelled scan"):
        list(room_objects(tmp_path))
    room(tmp_path, "attic", labels=200)
    with pytest.raises(InputFileError, match="200 labels for 300 points"):
        list(room_objects(tmp_path))
