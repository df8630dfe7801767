"""``artiworld doctor``: right about what is there, and about what is not."""

from __future__ import annotations

import json
import socket
import sqlite3
from pathlib import Path

import pytest

from app.cli import doctor
from app.cli.main import main
from model.core.errors import ConfigurationError
from sessions.store import Store
from tests.app.run_cli import artiworld


def by_name(checks) -> dict[str, doctor.Check]:
    return {check.name: check for check in checks}


def test_the_program_answers_in_json_and_as_a_table(tmp_path):
    done = artiworld("doctor", "--workspace", tmp_path / "w", "--json")
    report = json.loads(done.stdout)
    assert done.returncode == 0 and report["ok"]
    found = {check["name"]: check for check in report["checks"]}
    names = "python, viser, gpu, predictor geometric, segmenter default, workspace, database, port"
    more = "processors memory mujoco coacd usd-core pygltflib pybullet"
    for name in (*names.split(", "), *more.split()):
        assert name in found
    assert found["viser"]["found"] == "1.1.1"
    assert not (tmp_path / "w").exists()  # looking makes nothing


def test_a_workspace_that_cant_be_is_wrong_and_code_1(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(doctor, "check_torch", lambda: doctor.Check("gpu", "fine", "not asked"))
    (tmp_path / "file").write_text("x")
    assert main(["doctor", "--workspace", str(tmp_path / "file" / "w")]) == 1
    out = capfd.readouterr().out
    assert "wrong: workspace: choose another folder with --workspace" in out
    assert "predictor geometric" in out


def test_the_databases_format_is_read_without_touching_it(tmp_path):
    Store(tmp_path).close()
    file = tmp_path / "artiworld.db"
    before = file.read_bytes()
    check = by_name([doctor.check_database(tmp_path, None)])["database"]
    assert check.status == "fine" and "format" in check.found
    assert file.read_bytes() == before


@pytest.mark.parametrize("content", [b"not a database at all" * 100, b""])
def test_a_file_that_is_no_database_is_wrong(tmp_path, content):
    (tmp_path / "artiworld.db").write_bytes(content)
    assert doctor.check_database(tmp_path, None).status == "wrong"


def test_a_newer_format_is_wrong(tmp_path):
    Store(tmp_path).close()
    with sqlite3.connect(tmp_path / "artiworld.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    check = doctor.check_database(tmp_path, None)
    assert check.status == "wrong" and "9999" in check.found


@pytest.mark.parametrize(
    "url", ["nonsense", "postgresql+nodriver://x/y", "sqlite:////nowhere/at/all.db"]
)
def test_a_database_url_that_cant_work(tmp_path, url):
    check = doctor.check_database(tmp_path, url)
    assert check.status == ("fine" if url.startswith("sqlite") else "wrong")
    assert not Path("/nowhere").exists()


def test_a_taken_port_is_a_note():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        check = doctor.check_port(taken.getsockname()[1])
    assert check.status == "note" and "in use" in check.found


def test_missing_and_wrong_packages_are_named(monkeypatch):
    from importlib.metadata import PackageNotFoundError

    real = doctor.version

    def version(name: str) -> str:
        if name == "lxml":
            raise PackageNotFoundError(name)
        return "1.0.0" if name == "viser" else real(name)

    monkeypatch.setattr(doctor, "version", version)
    checks = by_name(doctor.check_packages())
    assert checks["lxml"].status == "wrong" and "pip install" in checks["lxml"].remedy
    assert checks["viser"].status == "wrong" and "viser==1.1.1" in checks["viser"].remedy
    assert checks["numpy"].status == "fine"


def test_a_broken_plugin_is_a_note_with_its_reason(monkeypatch):
    def load(name: str):
        if name == "b":
            raise ConfigurationError("its weights are missing")
        if name == "c":
            raise OSError("odd")

    monkeypatch.setattr("app.cli.doctor.predictor_names", lambda: ("a", "b", "c"))
    monkeypatch.setattr("app.cli.doctor.load_predictor", load)
    checks = by_name(doctor.check_plugins())
    assert checks["predictor a"].status == "fine"
    assert "weights" in checks["predictor b"].remedy
    assert checks["predictor c"].status == "note" and "odd" in checks["predictor c"].found
