"""``artiworld user`` and ``artiworld audit``."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from app.cli.main import main
from sessions.store import Store
from tests.sessions.people import PASSWORD, add_people


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    store = Store(tmp_path)
    add_people(store)
    store.close()
    return tmp_path


def run(workspace: Path, *words: str) -> int:
    return main([*words, "--workspace", str(workspace)])


def test_add_reads_the_password_and_shows_it_nowhere(workspace, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("a very long password\n"))
    assert run(workspace, "user", "add", "zoe", "--role", "reviewer") == 0
    assert capsys.readouterr().out == "Added zoe, reviewer\n"
    store = Store(workspace)
    assert store.people.accounts.check("zoe", "a very long password") is not None
    store.close()
    monkeypatch.setattr("sys.stdin", io.StringIO("short\n"))
    assert run(workspace, "user", "add", "eve") == 2
    assert "give 10 to 1000" in capsys.readouterr().err


def test_invite_prints_a_link_that_works(workspace, capsys):
    assert run(workspace, "user", "invite", "zoe", "--url", "https://scans.example.org/") == 0
    link = capsys.readouterr().out.split()[-1]
    assert link.startswith("https://scans.example.org/login#invitation=")
    store = Store(workspace)
    assert store.people.accounts.claim(link.partition("=")[2], PASSWORD).name == "zoe"
    store.close()


def test_role_disable_revoke_and_list(workspace, capsys):
    store = Store(workspace)
    session = store.people.credentials.begin_session(store.people.accounts.find("rob"))
    assert run(workspace, "user", "role", "ann", "reviewer") == 0
    assert run(workspace, "user", "disable", "bob") == 0
    assert run(workspace, "user", "revoke", "rob") == 0
    assert store.people.credentials.session(session) is None
    store.close()
    capsys.readouterr()
    assert run(workspace, "user", "list", "--json") == 0
    listed = {a["name"]: (a["role"], a["status"]) for a in json.loads(capsys.readouterr().out)}
    assert listed["ann"] == ("reviewer", "active") and listed["bob"] == ("annotator", "disabled")
    assert run(workspace, "user", "disable", "mia") == 2
    assert "last manager" in capsys.readouterr().err
    assert run(workspace, "user", "role", "nobody", "manager") == 2
    assert "there is no account 'nobody'" in capsys.readouterr().err


def test_a_token_is_printed_and_the_audit_names_it_without_its_secret(workspace, capsys):
    assert run(workspace, "user", "token", "rob", "--label", "night", "--scope", "review") == 0
    secret = capsys.readouterr().out.strip()
    store = Store(workspace)
    person = store.people.credentials.token(secret)
    assert person is not None and person.scopes == {"review"}
    store.close()
    assert run(workspace, "audit", "--kind", "token_made") == 0
    printed = capsys.readouterr().out
    assert "night: review" in printed and "command line" in printed and secret not in printed
    assert run(workspace, "audit", "--kind", "nonsense") == 2
    assert "there is no event 'nonsense'" in capsys.readouterr().err
    assert run(workspace, "audit", "--since", "2999-01-01") == 0
    assert capsys.readouterr().out == "Nothing\n"
    assert run(workspace, "user", "token", "ann", "--scope", "manage") == 2
    assert "doesn't allow manage" in capsys.readouterr().err
