"""Accounts, what proves them, and the record of what happened to them."""

import sqlite3
from pathlib import Path

import pytest
from argon2 import PasswordHasher

from model.core.errors import CommandError, ConfigurationError
from model.segmentation.prompts import Click
from sessions import accounts
from sessions import accounts as accounts_module
from sessions import credentials as credentials_module
from sessions.commands import AddClick, Reject, Reopen
from sessions.live import LiveSession
from sessions.store import Store
from tests.sessions.people import PASSWORD

CLICK = AddClick(Click((0.0, 0.0, 0.0), 1))


@pytest.fixture
def live(store: Store) -> LiveSession:
    return LiveSession(store, store.open_object(Path("/scans/oven.ply"), None, "oven").id)


# --- names and passwords


def test_without_accounts_nobody_logs_in_and_everybody_decides(store, live):
    assert not store.people.accounts.in_use()
    live.do(CLICK, "whoever")
    assert live.do(Reject("axis"), "whoever else").present.review.state == "rejected"


@pytest.mark.parametrize("name", ["ann", "ANN", "ＡＮＮ"])
def test_a_name_is_taken_whatever_its_case_and_width(people, name):
    with pytest.raises(ConfigurationError, match="already"):
        people.accounts.add(name, "manager", PASSWORD)


@pytest.mark.parametrize("name", ["segmenter", "Scene", "x", "", "two  blanks"])
def test_names_of_programs_and_unreadable_ones_are_refused(store, name):
    with pytest.raises(ConfigurationError):
        store.people.accounts.add(name, "manager", PASSWORD)


@pytest.mark.parametrize("password", ["short", "annanna123", "x" * 1001])
def test_bad_passwords_are_refused(store, password):
    with pytest.raises(ConfigurationError, match="password"):
        store.people.accounts.add("annanna", "annotator", password)


def test_passwords_are_stored_as_argon2_hashes_only(people, store):
    database = sqlite3.connect(store.workspace / "artiworld.db")
    (stored,) = database.execute("SELECT password FROM accounts WHERE name='ann'").fetchone()
    database.close()
    assert stored.startswith("$argon2id$")
    assert accounts.hasher.time_cost < PasswordHasher().time_cost, "tests hash cheaply"


@pytest.mark.parametrize("name", ["ann", "nobody at all", "gone", "invited"])
def test_a_wrong_login_does_the_same_work_for_every_name(people, monkeypatch, name):
    people.accounts.invite("invited", "annotator")
    people.accounts.add("gone", "annotator", PASSWORD)
    people.accounts.disable("gone")
    done = []

    class Counting(PasswordHasher):
        def verify(self, hash, password):
            done.append(hash.split("$")[1:4])
            return super().verify(hash, password)

    monkeypatch.setattr(accounts, "hasher", Counting(1, 64, 1))
    accounts.dummy_hash.cache_clear()
    assert people.accounts.check(name, "a wrong password") is None
    assert done == [["argon2id", "v=19", "m=64,t=1,p=1"]]
    accounts.dummy_hash.cache_clear()


def test_a_disabled_account_has_no_way_in(people):
    accounts, credentials = people.accounts, people.credentials
    ann = accounts.find("ann")
    session = credentials.begin_session(ann)
    token = credentials.make_token(ann, "script", ["read"])
    accounts.disable("ann", "mia")
    assert accounts.check("ann", PASSWORD) is None
    assert credentials.session(session) is None
    assert credentials.token(token) is None


def test_the_last_manager_stays(people):
    for act in (lambda a: a.disable("mia"), lambda a: a.set_role("mia", "annotator")):
        with pytest.raises(ConfigurationError, match="last manager"):
            act(people.accounts)


# --- invitations


def test_an_invitation_works_once(people):
    secret = people.accounts.invite("new one", "annotator", "mia")
    assert people.accounts.invited(secret).name == "new one"
    people.accounts.claim(secret, PASSWORD)
    assert people.accounts.check("new one", PASSWORD)
    with pytest.raises(ConfigurationError, match="expired or was used"):
        people.accounts.claim(secret, "another password")


def test_an_invitation_expires_and_a_newer_one_replaces_it(people, monkeypatch):
    old = people.accounts.invite("new one", "annotator")
    new = people.accounts.invite("new one", "reviewer")
    assert people.accounts.invited(old) is None
    assert people.accounts.invited(new).role == "reviewer"
    monkeypatch.setattr(accounts_module, "INVITATION_SECONDS", -1.0)
    late = people.accounts.invite("late one", "annotator")
    with pytest.raises(ConfigurationError, match="expired"):
        people.accounts.claim(late, PASSWORD)


def test_an_active_account_can_not_be_taken_over_by_an_invitation(people):
    with pytest.raises(ConfigurationError, match="already"):
        people.accounts.invite("ann", "manager")


# --- sessions and tokens


def test_a_new_password_ends_the_other_sessions_and_all_tokens(people):
    ann, credentials = people.accounts.find("ann"), people.credentials
    here, there = credentials.begin_session(ann), credentials.begin_session(ann)
    token = credentials.make_token(ann, "script", ["read"])
    people.accounts.change_password("ann", "quite another one", "ann", keep=here)
    assert credentials.session(here) is not None
    assert credentials.session(there) is None
    assert credentials.token(token) is None
    assert people.accounts.check("ann", PASSWORD) is None
    assert people.accounts.check("ann", "quite another one") == ann


def test_sessions_end_when_logged_out_revoked_or_old(people, monkeypatch):
    ann, credentials = people.accounts.find("ann"), people.credentials
    one, two = credentials.begin_session(ann), credentials.begin_session(ann)
    credentials.end_session(one)
    assert credentials.session(one) is None and credentials.session(two) is not None
    credentials.revoke(ann, "mia")
    assert credentials.session(two) is None
    monkeypatch.setattr(credentials_module, "SESSION_SECONDS", -1.0)
    assert credentials.session(credentials.begin_session(ann)) is None


def test_secrets_are_not_in_the_database(people, store):
    ann, credentials = people.accounts.find("ann"), people.credentials
    secrets = [
        credentials.begin_session(ann),
        credentials.make_token(ann, "script", ["read"]),
        people.accounts.invite("new one", "annotator"),
    ]
    database = sqlite3.connect(store.workspace / "artiworld.db")
    dump = "\n".join(database.iterdump())
    database.close()
    assert not [secret for secret in secrets if secret in dump]


def test_a_token_allows_at_most_what_the_role_does(people):
    credentials, accounts = people.credentials, people.accounts
    for scope in ("review", "manage"):
        with pytest.raises(ConfigurationError, match="doesn't allow"):
            credentials.make_token(accounts.find("ann"), "script", ["read", scope])
    with pytest.raises(ConfigurationError, match="scopes must be of"):
        credentials.make_token(accounts.find("ann"), "script", ["everything"])
    token = credentials.make_token(accounts.find("rob"), "script", ["read", "review"])
    assert credentials.token(token).scopes == {"read", "review"}
    accounts.set_role("rob", "annotator")
    assert credentials.token(token).scopes == {"read"}, "a lower role counts for old tokens, too"


def test_a_revoked_or_expired_token_is_nobody(people, monkeypatch):
    credentials, ann = people.credentials, people.accounts.find("ann")
    secret = credentials.make_token(ann, "script", ["read"])
    credentials.revoke_token(credentials.tokens(ann)[0].id)
    assert credentials.token(secret) is None
    assert credentials.token("awt_guessed") is None
    old = credentials.make_token(ann, "script", ["read"])
    monkeypatch.setattr(credentials_module, "now", lambda *_: "2999-01-01T00:00:00.000000Z")
    assert credentials.token(old) is None


# --- roles, where commands are applied


def test_only_reviewers_decide_and_at_once_with_a_new_role(people, live):
    live.do(CLICK, "ann")
    with pytest.raises(CommandError, match="only a reviewer"):
        live.do(Reject("axis"), "ann")
    live.do(Reject("axis"), "rob")
    people.accounts.set_role("rob", "annotator")
    people.work.leave(live.object_id, people.accounts.find("ann"))
    with pytest.raises(CommandError, match="only a reviewer"):
        live.do(Reopen(), "rob")


def test_a_lower_role_can_be_asked_for_but_no_higher_one(people, live):
    with pytest.raises(CommandError, match="only a reviewer"):
        live.do(Reject("axis"), "rob", role="annotator")
    with pytest.raises(CommandError, match="only a reviewer"):
        live.do(Reject("axis"), "ann", role="manager")


@pytest.mark.parametrize("name", ["nobody at all", "gone", ""])
def test_without_an_active_account_nothing_is_decided(people, live, name):
    people.accounts.add("gone", "reviewer", PASSWORD)
    people.accounts.disable("gone")
    for command in (CLICK, Reject("axis")):
        with pytest.raises(CommandError, match="has no active account"):
            live.do(command, name)


# --- audit


def test_the_audit_says_who_did_what_to_whom(people):
    people.accounts.set_role("ann", "reviewer", by="mia")
    people.audit.add("login_failed", "rob", "rob", address="10.0.0.9")
    newest = people.audit.events(count=2)
    found = [(e.kind, e.who, e.subject) for e in newest]
    assert found == [("login_failed", "rob", "rob"), ("role_changed", "mia", "ann")]
    assert newest[0].address == "10.0.0.9"
    assert newest[1].detail == "annotator → reviewer"
    assert {e.subject for e in people.audit.events(name="ann")} == {"ann"}
    assert [e.kind for e in people.audit.events(kind="role_changed")] == ["role_changed"]
    assert people.audit.events(before=newest[1].id, count=1)[0].id == newest[1].id - 1
    assert people.audit.events(since="2999") == []
    with pytest.raises(ConfigurationError, match="there is no event 'x'"):
        people.audit.events(kind="x")


def test_decisions_are_found_by_person_object_and_kind(people, live):
    live.do(CLICK, "ann")
    live.do(Reject("axis"), "rob")
    log = people.audit
    found = [(d.who, d.kind, d.name) for d in log.decisions()]
    assert found == [("rob", "reject", "oven"), ("ann", "add_click", "oven")]
    assert [d.seq for d in log.decisions(who="ann")] == [1]
    assert [d.seq for d in log.decisions(kind="reject", object_id=live.object_id)] == [2]
    assert [d.seq for d in log.decisions(first=1, count=1)] == [1]
    assert log.decisions(object_id=99) == log.decisions(since="2999") == []


@pytest.mark.parametrize("statement", ["UPDATE audit SET who='eve'", "DELETE FROM audit"])
def test_nothing_of_the_audit_can_be_changed(people, store, statement):
    database = sqlite3.connect(store.workspace / "artiworld.db")
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        database.execute(statement)
    database.close()


@pytest.mark.parametrize(
    "name",
    [
        "\u0430nn", "a\u200bnn", "ann\u200d", "a\u00adnn", "a\ufe0fnn", "a\u034fnn", "ann\u3164",
        "\u0410nn Lee", "\u03bfscar", "a\u202enn", "ann\x00", "a\tnn", "\u0455\u0441ot",
    ],
)  # fmt: skip
def test_names_that_look_like_another_are_refused(store: Store, name: str) -> None:
    with pytest.raises(ConfigurationError, match=r"can't be seen|mixes"):
        store.people.accounts.invite(name, "annotator")


@pytest.mark.parametrize(
    "name",
    ["Ann Lee", "Žofie", "Ольга П.", "李雷", "山田 たろう", "김철수", "José-María 2", "Li 李"],
)
def test_names_of_one_script_are_taken(store: Store, name: str) -> None:
    store.people.accounts.invite(name, "annotator")
    assert name in [a.name for a in store.people.accounts.all()]
