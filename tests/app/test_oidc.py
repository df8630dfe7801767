"""Login with a real OpenID Connect provider that runs here, and attacks on it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

import pytest

from app.server.login import OidcError, OidcLogin, OidcSettings
from app.server.server import Server
from model.core.errors import ConfigurationError
from sessions.store import Store
from tests.app.api_server import Browser, team_server
from tests.app.run_cli import artiworld, assert_users_mistake
from tests.sessions.people import PASSWORD

httpx = pytest.importorskip("httpx", reason="the extra oidc is not installed")
mock = pytest.importorskip("oidc_provider_mock", reason="no provider: pip install artiworld[test]")
pytest.importorskip("authlib", reason="the extra oidc is not installed")


@pytest.fixture(scope="module")
def issuer() -> Iterator[str]:
    users = [
        mock.User(sub="1", claims={"preferred_username": "nora", "groups": ["staff", "reviewer"]}),
        mock.User(sub="2", claims={"preferred_username": "ann", "groups": ["manager"]}),
        mock.User(sub="3", claims={"preferred_username": "zoe"}),
        mock.User(sub="4", claims={"email": "eve@example.org", "email_verified": False}),
    ]
    with mock.run_server_in_thread(user_claims=users) as provider:
        yield f"http://localhost:{provider.server_port}"


@pytest.fixture
def server(issuer: str, tmp_path: Path) -> Iterator[Server]:
    settings = OidcSettings(issuer, "artiworld", "secret", role_claim="groups")
    with team_server(tmp_path / "workspace", oidc=settings) as server:
        server.app_state.store.people.accounts.invite("nora", "annotator")
        yield server


def there(browser: Browser) -> str:
    """Begin a login; returns the provider's address."""
    connection = httpx.Client(follow_redirects=False)
    answer = connection.get(f"http://127.0.0.1:{browser.port}/api/v1/oidc/login?next=//evil.test")
    assert answer.status_code == 303
    cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=lax" in cookie
    browser.cookie = cookie.partition(";")[0]
    return answer.headers["Location"]


def authorized(address: str, subject: str) -> str:
    """Log in at the provider; returns path and query of the way back."""
    answer = httpx.post(address, data={"sub": subject})
    back = urlsplit(answer.headers["Location"])
    assert back.path == "/api/v1/oidc/callback"
    return f"{back.path}?{back.query}"


def test_an_invited_person_comes_in_and_stays_the_same(server: Server) -> None:
    browser = Browser(server)
    page = browser.ask("GET", "/login")[1].decode()
    assert "Log in with your organisation" in page and "/api/v1/oidc/login" in page
    address = there(browser)
    query = parse_qs(urlsplit(address).query)
    assert query["code_challenge_method"] == ["S256"] and "openid" in query["scope"][0]
    assert len(query["state"][0]) > 40 and len(query["nonce"][0]) > 40
    status, page = browser.ask("GET", authorized(address, "1"))
    assert status == 200 and b"location.replace('/')" in page and b"evil" not in page
    assert browser.cookie is not None and "_login" not in browser.cookie
    me = {"name": "nora", "role": "reviewer", "scopes": 0}
    assert browser.api("GET", "/me")[1] | {"scopes": 0} == me
    # Again, in another browser: the same account, known by its subject.
    second = Browser(server)
    second.ask("GET", authorized(there(second), "1"))
    assert second.api("GET", "/me")[1]["name"] == "nora"
    people = server.app_state.store.people
    assert [a.name for a in people.accounts.all()].count("nora") == 1
    people.accounts.disable("nora")
    third = Browser(server)
    status, page = third.ask("GET", authorized(there(third), "1"))
    assert status == 403 and b"nora is disabled" in page
    assert browser.api("GET", "/me")[0] == 401, "and who is in is out"


def test_a_client_without_a_secret_comes_in(issuer, tmp_path, monkeypatch) -> None:
    grants = pytest.importorskip("authlib.oauth2.rfc6749.grants")  # the provider's
    grant = grants.AuthorizationCodeGrant
    monkeypatch.setattr(grant, "TOKEN_ENDPOINT_AUTH_METHODS", ["none"])
    back = "http://localhost/api/v1/oidc/callback"
    public = {"redirect_uris": [back], "token_endpoint_auth_method": "none"}
    answer = httpx.post(f"{issuer}/oauth2/clients", json=public)
    client = answer.raise_for_status().json()["client_id"]
    settings = OidcSettings(issuer, client, None, role_claim="groups")
    origins = ("http://localhost",)
    with team_server(tmp_path, oidc=settings, allowed_origins=origins) as server:
        server.app_state.store.people.accounts.invite("nora", "annotator")
        browser = Browser(server)
        status, page = browser.ask("GET", authorized(there(browser), "1"))
        assert status == 200, page
        assert browser.api("GET", "/me")[1]["name"] == "nora"


def test_strangers_and_owners_of_passwords_stay_out(server: Server) -> None:
    refusals = {"3": b"zoe isn&#39;t invited", "2": b"ann isn&#39;t invited"}
    for subject, said in {**refusals, "4": b"says no preferred_username"}.items():
        browser = Browser(server)
        status, page = browser.ask("GET", authorized(there(browser), subject))
        assert (status, said in page) == (403, True), page
        assert browser.api("GET", "/me")[0] == 401
    password = Browser(server)
    assert password.log_in("ann", PASSWORD) == 200, "passwords go on working"
    assert password.api("GET", "/me")[1]["role"] == "annotator", "the provider took nothing over"
    kinds = [e.kind for e in server.app_state.store.people.audit.events(kind="login_failed")]
    assert len(kinds) == 3


def test_anybody_of_an_organisation_may_be_let_in(issuer: str, tmp_path: Path) -> None:
    settings = OidcSettings(issuer, "artiworld", "secret", anybody=True)
    with team_server(tmp_path, accounts=False, oidc=settings) as server:
        assert Browser(server).ask("GET", "/", own=False)[0] == 303, "nobody comes in without"
        browser = Browser(server)
        status, page = browser.ask("GET", authorized(there(browser), "3"))
        assert status == 200, page
        assert browser.api("GET", "/me")[1]["role"] == "annotator"


def test_answers_for_another_login_are_refused(server: Server) -> None:
    browser = Browser(server)
    back = authorized(there(browser), "1")
    path, _, query = back.partition("?")
    fields = {k: v[0] for k, v in parse_qs(query).items()}

    def refused(asking: Browser, **changed: str) -> bytes:
        status, page = asking.ask("GET", f"{path}?{urlencode(fields | changed)}")
        assert status == 403, page
        assert asking.api("GET", "/me")[0] == 401
        return page

    refused(browser, state="x" * 43)
    thief = Browser(server)
    there(thief)  # with a login and a cookie of its own
    refused(thief)  # the code of somebody else, and that login is over
    assert b"has expired or was used" in refused(browser)
    # A code that was used once.
    browser = Browser(server)
    back = authorized(there(browser), "1")
    assert browser.ask("GET", back)[0] == 200
    code = parse_qs(urlsplit(back).query)["code"][0]
    again = Browser(server)
    state = parse_qs(urlsplit(there(again)).query)["state"][0]
    assert b"take the code" in refused(again, state=state, code=code)
    again = Browser(server)
    state = parse_qs(urlsplit(there(again)).query)["state"][0]
    assert b"another provider" in refused(again, state=state, iss="https://evil.test")
    again = Browser(server)
    state = parse_qs(urlsplit(there(again)).query)["state"][0]
    status, page = again.ask("GET", f"{path}?state={state}&error=access_denied%3Cb%3E")
    assert (status, b"<b>" in page) == (403, False)


@pytest.fixture
def forging(issuer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """``forging(make)`` finishes a login whose token endpoint answers what ``make`` makes of the
    right claims."""
    from joserfc import jwk

    key = jwk.RSAKey.generate_key(2048, parameters={"kid": "k1"})
    store = Store(tmp_path)
    store.people.accounts.invite("nora", "annotator")
    login = OidcLogin(OidcSettings(issuer, "artiworld", "secret"), store.people)
    real, answers = httpx.Client.send, dict[str, str]()

    def send(self: Any, request: Any, **settings: Any) -> Any:
        if request.url.path.endswith("/jwks"):
            keys = {"keys": [key.as_dict(private=False)]}
            return httpx.Response(200, json=keys, request=request)
        if request.method == "POST":
            return httpx.Response(200, json=answers, request=request)
        return real(self, request, **settings)

    monkeypatch.setattr(httpx.Client, "send", send)

    def finish(make: Callable[[dict[str, Any], Any], str]) -> Any:
        address, cookie = login.begin("http://127.0.0.1/back")
        asked = {k: v[0] for k, v in parse_qs(urlsplit(address).query).items()}
        now = int(time.time())
        claims = {"iss": issuer, "aud": "artiworld", "sub": "1", "exp": now + 60, "iat": now}
        claims |= {"nonce": asked["nonce"], "preferred_username": "nora"}
        answers.update(access_token="x", token_type="Bearer", id_token=make(claims, key))
        return login.finish({"code": "c", "state": asked["state"]}, cookie, "http://127.0.0.1/back")

    yield finish
    store.close()


def signed(claims: dict[str, Any], key: Any, alg: str = "RS256") -> str:
    from joserfc import jwt

    return jwt.encode({"alg": alg, "kid": "k1"}, claims, key, algorithms=[alg])


def test_forged_tokens_are_refused(forging: Any) -> None:
    from joserfc import jwk
    from joserfc.util import to_str, urlsafe_b64encode

    def none(claims: dict[str, Any], _: Any) -> str:
        head = urlsafe_b64encode(json.dumps({"alg": "none"}).encode())
        return f"{to_str(head)}.{to_str(urlsafe_b64encode(json.dumps(claims).encode()))}."

    other = jwk.RSAKey.generate_key(2048, parameters={"kid": "k1"})
    secret = jwk.OctKey.import_key("secret" * 8)
    forged: dict[str, Callable[[dict[str, Any], Any], str]] = {
        "alg none": none,
        "another key": lambda c, _: signed(c, other),
        "signed with the secret": lambda c, _: signed(c, secret, "HS256"),
        "audience": lambda c, k: signed(c | {"aud": "other"}, k),
        "party": lambda c, k: signed(c | {"aud": ["artiworld", "b"], "azp": "b"}, k),
        "audiences without party": lambda c, k: signed(c | {"aud": ["artiworld", "b"]}, k),
        "issuer": lambda c, k: signed(c | {"iss": "https://evil.test"}, k),
        "nonce": lambda c, k: signed(c | {"nonce": "n"}, k),
        "no nonce": lambda c, k: signed({n: v for n, v in c.items() if n != "nonce"}, k),
        "expired": lambda c, k: signed(c | {"exp": 1}, k),
        "no end": lambda c, k: signed({n: v for n, v in c.items() if n != "exp"}, k),
        "no token": lambda _, __: "rubbish",
    }
    for what, make in forged.items():
        with pytest.raises(OidcError):
            pytest.fail(f"{what}: {forging(make)}")
    assert forging(signed).name == "nora", "and the right one comes in"


def test_settings_that_cannot_work_are_refused(tmp_path: Path) -> None:
    for wrong in ("http://login.example.org", "ftp://x", "https://", "https://a.test?x=1"):
        with pytest.raises(ConfigurationError, match="https://"):
            OidcSettings(wrong, "artiworld")
    done = artiworld("serve", "--workspace", tmp_path, "--oidc-issuer", "http://example.org")
    assert_users_mistake(done, "--oidc-issuer", "https://")
    store = Store(tmp_path)
    login = OidcLogin(OidcSettings("http://127.0.0.1:9", "artiworld"), store.people)
    with pytest.raises(OidcError, match="no usable OpenID Connect provider"):
        login.begin("http://127.0.0.1/back")
    store.close()
