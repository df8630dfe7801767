"""``artiworld bench faults``: damaged files and killed servers."""

from __future__ import annotations

import random
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.cli.benchmarks import faults
from app.cli.benchmarks.shapes import FaultSample, damaged, fault_samples
from app.cli.main import main
from app.server import network
from app.server.api import project
from app.server.api.project import check_url
from model.core.errors import InputFileError
from model.io.geometry_files import SUFFIXES
from model.io.open_asset import open_asset
from tests.app import job_functions as functions
from tests.app.run_cli import answer


def test_every_sample_can_be_read_and_the_formats_are_all_there(tmp_path: Path) -> None:
    samples = fault_samples()
    for number, sample in enumerate(samples):
        folder = tmp_path / f"{number}"
        folder.mkdir()
        for name, data in sample.files.items():
            (folder / name).write_bytes(data)
        assert faults.read_source(folder / sample.main, sample.is_scene) > 0, sample.name
    made = {Path(sample.main).suffix for sample in samples}
    same = {".xyzrgb", ".xyzn", ".pts", ".asc", ".usd", ".usdz"}
    assert set(SUFFIXES) - same <= made and {".zip", ".urdf", ".xml", ".sdf"} <= made


def test_a_seed_says_what_is_damaged() -> None:
    data = bytes(range(256)) * 4
    for seed in range(50):
        once, again = (damaged(data, random.Random(f"{seed}")) for _ in range(2))
        assert once == again
    assert len({damaged(data, random.Random(f"{seed}")) for seed in range(50)}) > 40


def test_some_of_every_format(capfd) -> None:
    report = answer("bench", "faults", "--limit", "62", "--seed", "7")
    assert sum(row["files"] for row in report["rows"]) == 62 and not report["bad"]
    assert all(row["read"] + row["refused"] == row["files"] for row in report["rows"])


@pytest.mark.parametrize("kind", ["crash", "hang", "blow-up", "our fault"])
def test_bad_readings_are_told_apart_with_their_seed(kind, capfd, monkeypatch) -> None:
    monkeypatch.setattr(faults, "read_source", functions.read_badly)
    monkeypatch.setattr(faults, "damaged", lambda data, rng: data)
    if kind == "hang":
        monkeypatch.setattr(faults, "SECONDS", 1.0)
    sample = FaultSample("odd", {"a.odd": kind.encode()}, "a.odd")
    monkeypatch.setattr(faults, "fault_samples", lambda: [sample])
    assert main(["bench", "faults", "--limit", "1", "--seed", "41"]) == 1
    said = capfd.readouterr().out
    assert f"seed 41: {kind}: odd" in said
    assert kind != "our fault" or "chapter" in said


@pytest.mark.slow
def test_killed_servers_lose_nothing_and_leave_nothing(capfd) -> None:
    kills = answer("bench", "faults", "--limit", "0", "--kills", "2")["kills"]
    assert kills["kills"] == 2 and kills["uploaded"] > 0
    assert not kills["lost"] and not kills["left over"]


@pytest.mark.parametrize("answers", [True, False])
def test_a_click_without_its_labels_is_lost(answers: bool, monkeypatch) -> None:
    monkeypatch.setattr(faults, "LOST", 0.2)
    doc = SimpleNamespace(prompts=[], segmentation_current=True)
    asset = SimpleNamespace(bounds=np.zeros((2, 3)))
    app: Any = SimpleNamespace(drawing=SimpleNamespace(shows_labels=True))
    app.tab = SimpleNamespace(
        selection=SimpleNamespace(object=SimpleNamespace(document=doc, asset=asset)),
        act=lambda action: action(),
    )
    app.pointing = SimpleNamespace(click=lambda *_: doc.prompts.append(1) if answers else None)
    browser: Any = SimpleNamespace(last=time.perf_counter())
    taken = faults.timed_click(browser, app, np.random.default_rng(0))
    assert (taken < 0.2) == answers and (taken == faults.LOST) != answers


@pytest.mark.slow
def test_clicks_are_measured_beside_files_that_open_and_files_that_are_refused(
    capfd, monkeypatch: pytest.MonkeyPatch
) -> None:
    def two_files(folder: Path) -> list[Path]:
        files = [folder / "nothing.obj", folder / "triangle.obj"]
        files[0].write_text("v 0 0 0\n")
        files[1].write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        return files

    monkeypatch.setattr(faults, "PEOPLE", 2)
    monkeypatch.setattr(faults, "POINTS", 20_000)
    monkeypatch.setattr(faults, "PAUSE", (0.05, 0.1))
    monkeypatch.setattr(faults, "write_worst", two_files)
    alone, beside = answer("bench", "faults", "--limit", "0", "--clients", "4")["clients"]
    assert alone["with"] == "nobody else" and not alone["opened"] and alone["p95 ratio"] == 1.0
    assert beside["opened"] >= 1 <= beside["refused"]
    for row in (alone, beside):
        assert row["clicks"] >= 2 and not row["lost"]
        assert 0 < row["p50 ms"] <= row["p95 ms"] <= row["longest ms"] < 1000 * faults.LOST


@pytest.mark.slow
def test_the_worst_files_are_refused_or_opened(tmp_path: Path) -> None:
    for path in faults.write_worst(tmp_path):
        if path.stem in ("face", "shared", "line"):
            with pytest.raises(InputFileError, match=r"corners|two parents|characters"):
                open_asset(path)
        else:
            assert open_asset(path).element_count == {"nodes": 200_000, "map": 1}[path.stem]


def test_a_person_is_answered_beside_strangers_who_are_slow(monkeypatch) -> None:
    monkeypatch.setattr(faults, "STRANGERS", 40)
    monkeypatch.setattr(network, "MAX_SOCKETS", 20)
    alone, beside = faults.ask_beside(4)
    assert alone["with"] == "nobody else" and beside["with"] == "40 strangers"
    for row in (alone, beside):
        assert row["requests"] >= 1 and not row["refused"]
        assert 0 < row["p50 ms"] <= row["p95 ms"] <= row["longest ms"]


def test_a_sound_webhook_gets_its_message_beside_poisoned_ones() -> None:
    raised: list[object] = []

    def note(url: str, allowed: Any) -> Any:
        try:
            return check_url(url, allowed)
        except KeyError as error:
            raised.append(error)
            raise

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(project, "check_url", note)
        alone, beside = faults.deliver_beside()
    assert alone["with"] == "0 poisoned webhooks" and beside["with"] == "20 poisoned webhooks"
    assert 0 <= alone["sent after s"] < faults.LOST > beside["sent after s"] >= 0
    assert raised
