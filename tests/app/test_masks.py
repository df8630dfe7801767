"""Masks of another system as a starting point: in the browser's session and on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from app.cli.main import main, parse
from app.cli.serve import make_config
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from model import open_asset, with_masks
from model.core.errors import ConfigurationError, InputFileError
from model.io.write import write_mesh
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.provenance import provenance
from sessions.store import Store
from tests.builders import cabinet_mesh, wait_until

LABELS = cabinet_mesh(2).labels
MERGED = np.where(LABELS == 2, 1, LABELS)
"""What a system says that takes both doors for one part."""


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    mesh = cabinet_mesh(2).asset.mesh
    assert mesh is not None
    return write_mesh(mesh, tmp_path / "cabinet.obj")[0]


@pytest.fixture
def masks(tmp_path: Path) -> Path:
    (tmp_path / "results").mkdir()
    path = tmp_path / "results/mesh_1.0.npz"
    np.savez(path, labels=MERGED, names=np.array(["body", "door"]))
    return path


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[[Path, Path], OpenObject]]:
    states: list[AppState] = []

    def begin(path: Path, masks: Path) -> OpenObject:
        workspace = tmp_path / "workspace"
        config = ServeConfig(paths=(path,), workspace=workspace, up_axis="z", masks=masks)
        states.append(AppState(config, Store(workspace), [path]))
        obj = states[-1].object(states[-1].queue.records()[0].id)
        wait_until(lambda: obj.labels is not None or obj.problem, "it is open")
        wait_until(lambda: not obj.jobs, "nothing is under way")
        return obj

    yield begin
    for state in states:
        state.close()


def test_parts_from_masks_are_corrected_by_clicks_and_undone(opened, scan, masks) -> None:
    obj = opened(scan, masks)
    doc = obj.document
    assert [(p.id, p.name) for p in doc.parts] == [(0, "body"), (1, "door")]
    stored = obj.services.store.get_array(doc.segmentation.labels)
    assert np.array_equal(stored, MERGED)
    # The second door is a part of its own.
    element = int(np.flatnonzero(LABELS == 2)[10])
    center = cabinet_mesh(2).asset.element_centers[element]
    obj.do(cmd.AddPart(2), "ann")
    obj.do(cmd.AddClick(Click(tuple(center.tolist()), 2, True, element)), "ann")
    wait_until(lambda: obj.document.segmentation_current and not obj.jobs, "it is segmented")
    labels = obj.services.store.get_array(obj.document.segmentation.labels)
    assert (labels[LABELS == 2] == 2).mean() >= 0.5 and (labels[LABELS == 1] == 1).all()

    entries = list(obj.services.store.history(obj.record.id))
    told = provenance(obj.state, entries, None)
    (source,) = told["masks"]
    assert source.startswith("masks mesh_1.0.npz (sha256 ")
    assert {p["tool"] for p in told["prompts"] if p["kind"] == "region"} == {source}
    while obj.state.can_undo:
        obj.do(cmd.Undo(), "ann")
    assert not obj.document.prompts
    assert not provenance(obj.state, obj.services.store.history(obj.record.id), None)["masks"]


def test_masks_that_dont_fit_are_told_on_opening(opened, scan, tmp_path: Path) -> None:
    np.save(tmp_path / "short.npy", np.arange(7))
    obj = opened(scan, tmp_path / "short.npy")
    assert "short.npy" in obj.problem and "7 labels" in obj.problem


def test_segment_starts_from_masks_and_takes_clicks_on_top(scan, masks, tmp_path: Path) -> None:
    words = ["segment", str(scan), "--up-axis", "z", "--masks", str(masks), "--json"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    said = json.loads((tmp_path / "out/object.json").read_text())
    assert [(p["name"], p["count"]) for p in said["parts"]] == [
        ("body", int((MERGED == 0).sum())), ("door", int((MERGED == 1).sum())),
    ]  # fmt: skip
    assert said["masks"].startswith("mesh_1.0.npz") and said["segmenter"] == "masks"

    element = int(np.flatnonzero(LABELS == 2)[10])
    center = cabinet_mesh(2).asset.element_centers[element].tolist()
    prompts = {"parts": [{"id": 2, "name": "right door"}],
               "clicks": [{"position": center, "part": 2, "element": element}]}  # fmt: skip
    (tmp_path / "p.json").write_text(json.dumps(prompts))
    more = ["--prompts", str(tmp_path / "p.json"), "--out", str(tmp_path / "clicked")]
    assert main([*words, *more]) == 0
    said = json.loads((tmp_path / "clicked/object.json").read_text())
    assert [p["name"] for p in said["parts"]] == ["body", "door", "right door"]
    assert said["segmenter"] != "masks" and said["masks"].startswith("mesh_1.0.npz")


def test_neither_prompts_nor_masks_is_one_line(scan, tmp_path: Path, capsys) -> None:
    assert main(["segment", str(scan), "--out", str(tmp_path / "out")]) == 2
    assert "give --prompts or --masks" in capsys.readouterr().err


def test_the_python_api(scan, masks) -> None:
    asset = with_masks(open_asset(scan, up_axis="z"), masks)
    assert np.array_equal(asset.element_part, MERGED) and asset.part_names == ("body", "door")


def test_serve_takes_masks_of_one_object(scan, masks, tmp_path: Path) -> None:
    def config_of(*words: object) -> ServeConfig:
        return make_config(parse(["serve", *map(str, words)])[0])

    assert config_of(scan, "--masks", masks).masks == masks
    with pytest.raises(ConfigurationError, match="of one object"):
        config_of(scan, tmp_path / "results", "--masks", masks)
    with pytest.raises(InputFileError, match=r"nothing\.npy"):
        config_of(scan, "--masks", tmp_path / "nothing.npy")
