"""Logging in: the token, the cookie that proves it, the page that asks for it, and the page of
people with accounts.
"""

from __future__ import annotations

import hashlib
import hmac
import html
import json
import secrets
import time
from collections import OrderedDict

from app.server.network import API
from model.core.errors import ConfigurationError

MIN_TOKEN_LENGTH = 8
ATTEMPTS = 5
"""Wrong tokens after which an address has to wait."""
GUESSES = 100
"""Wrong tokens after which an address is guessing: even the right one is refused then."""
ATTEMPT_SECONDS = 60.0
"""Time after which a wrong token no longer counts."""
_ADDRESSES_KEPT = 10_000

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; background: #f4f5f7; color: #1c2430; margin: 0;
  display: grid; place-items: center; min-height: 100vh; }
form { background: #fff; padding: 2rem; border-radius: 10px; width: 20rem;
  box-shadow: 0 2px 12px #0002; }
h1 { font-size: 1.3rem; margin: 0 0 1rem; }
input, button { font: inherit; width: 100%; box-sizing: border-box; padding: .5rem .7rem;
  border-radius: 6px; border: 1px solid #b9c0cb; margin-top: .4rem; }
button { background: #2b59c3; color: #fff; border: 0; margin-top: 1rem; cursor: pointer; }
a.button { display: block; text-align: center; padding: .5rem .7rem; border-radius: 6px;
  border: 1px solid #2b59c3; color: #2b59c3; text-decoration: none; margin-top: 1rem; }
p { color: #b3261e; min-height: 1.5em; margin: .5rem 0 0; }
"""

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>ArtiWorld: log in</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style nonce="{nonce}">{style}</style></head><body>
<form action="/login" method="get" autocomplete="off"><h1>ArtiWorld</h1>
<label>Token<input type="password" name="token" required autofocus></label>
<button>Log in</button><p id="problem" role="alert">{problem}</p></form>
<script nonce="{nonce}">
// Send the token in a header, so that it stands in no address and no history.
const form = document.querySelector("form");
form.addEventListener("submit", async (event) => {{
  event.preventDefault();
  const answer = await fetch("/login", {{
    headers: {{ "X-ArtiWorld-Token": encodeURIComponent(form.token.value) }}, cache: "no-store" }});
  if (answer.ok) location.replace("/");
  else document.querySelector("#problem").textContent = await answer.text();
}});
</script></body></html>
"""


class Attempts:
    """Wrong tokens and passwords of the last minute by address or name. Not thread-safe."""

    def __init__(self) -> None:
        self._failures: OrderedDict[str, list[float]] = OrderedDict()

    def recent(self, key: str) -> int:
        """Return how many there were."""
        now = time.monotonic()
        return sum(now - t < ATTEMPT_SECONDS for t in self._failures.get(key, []))

    def guessing(self, key: str) -> bool:
        """True after so many attempts that even the right secret is refused."""
        return self.recent(key) >= GUESSES

    def right(self, key: str) -> None:
        """Take back the last note of a wrong one."""
        if times := self._failures.get(key):
            times.pop()

    def failed(self, key: str) -> None:
        """Note a wrong one, or one that waits to be checked."""
        now = time.monotonic()
        recent = [t for t in self._failures.get(key, []) if now - t < ATTEMPT_SECONDS]
        self._failures[key] = [*recent, now]
        self._failures.move_to_end(key)
        while len(self._failures) > _ADDRESSES_KEPT:
            self._failures.popitem(last=False)


class Login:
    """Checks tokens and cookies, on the server's event loop: not thread-safe.

    Args:
        token: the secret; None admits everybody.

    Raises:
        ConfigurationError: where the token is too short.
    """

    def __init__(self, token: str | None) -> None:
        if token is not None and len(token) < MIN_TOKEN_LENGTH:
            raise ConfigurationError(
                f"--token has {len(token)} characters; give at least {MIN_TOKEN_LENGTH}"
            )
        self._token = token
        # Derived, so that a leaked cookie doesn't reveal the token; stable, so that people stay
        # logged in when the server restarts.
        self._session = (
            None
            if token is None
            else hmac.new(token.encode(), b"artiworld session", hashlib.sha256).hexdigest()
        )
        self._attempts = Attempts()

    @property
    def needed(self) -> bool:
        """True if there is a token."""
        return self._token is not None

    def knows(self, cookies: list[str], port: int) -> bool:
        """True if one of the ``Cookie`` headers proves an earlier login."""
        if self._session is None:
            return True
        # Not http.cookies, which stops at the first malformed cookie of another local program.
        for pair in ";".join(cookies).split(";"):
            name, _, value = pair.strip().partition("=")
            if name == cookie_name(port) and hmac.compare_digest(
                value.encode("utf-8", "replace"), self._session.encode()
            ):
                return True
        return False

    def try_token(self, token: str, address: str) -> bool | None:
        """Return True for the right token, False for a wrong one, None after too many wrong ones.

        Behind a proxy all visitors have one address: mistakes must not keep the others out, so the
        right token still counts until :data:`GUESSES`.
        """
        if self._token is None:
            return True
        recent = self._attempts.recent(address)
        if recent >= GUESSES:
            return None
        if hmac.compare_digest(token.encode("utf-8", "replace"), self._token.encode()):
            return True  # the wrong ones still count: another visitor may be guessing
        self._attempts.failed(address)
        return False if recent < ATTEMPTS else None

    def cookie(self, port: int, *, secure: bool) -> str:
        """Return the ``Set-Cookie`` header of a visitor who knew the token."""
        flags = "; Path=/; HttpOnly; SameSite=Strict; Max-Age=2592000"
        return f"{cookie_name(port)}={self._session}{flags}" + ("; Secure" if secure else "")


def cookie_name(port: int) -> str:
    """Return the cookie's name, with the port: browsers share cookies between a host's ports."""
    return f"artiworld_{port}"


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(24)


def login_page(problem: str = "") -> tuple[bytes, str]:
    """Return the page, and the content security policy that allows its script only."""
    nonce = secrets.token_urlsafe(16)
    page = _PAGE.format(nonce=nonce, style=_STYLE, problem=html.escape(problem))
    return page.encode(), page_policy(nonce)


def page_style() -> str:
    """Return the CSS of the pages shown before login."""
    return _STYLE


def page_policy(nonce: str) -> str:
    """Return the content security policy that allows the script of ``nonce`` only."""
    return (
        f"default-src 'none'; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    )


_ACCOUNT_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>ArtiWorld: your account</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style nonce="{nonce}">{style}</style></head><body>
<form hidden id="login"><h1>ArtiWorld</h1>
<label>Name<input name="name" autocomplete="username" required autofocus></label>
<label>Password<input type="password" name="password" autocomplete="current-password" required>
</label><button>Log in</button><p role="alert"></p>{provider}</form>
<form hidden id="invitation"><h1>Welcome, <span></span></h1>
<label>Choose a password<input type="password" name="password" autocomplete="new-password"
 minlength="10" required></label><button>Begin</button><p role="alert"></p></form>
<form hidden id="account"><h1><span></span></h1>
<label>Password<input type="password" name="old" autocomplete="current-password" required></label>
<label>New password<input type="password" name="new" autocomplete="new-password" minlength="10"
 required></label><button>Change password</button>
<button type="button" id="logout">Log out</button><p role="alert"></p><a href="/">Back</a></form>
<script nonce="{nonce}">
const api = {api}, person = {person};
const ask = (path, body) => fetch(api + path, {{ method: "POST", cache: "no-store",
  headers: {{ "Content-Type": "application/json", "X-ArtiWorld": "1" }},
  body: JSON.stringify(body) }});
// The invitation stands behind the #, so that it is in no log of a server.
const code = new URLSearchParams(location.hash.slice(1)).get("invitation");
function show(id, title, path, extra, then) {{
  const form = document.getElementById(id), said = form.querySelector("p");
  form.hidden = false;
  if (title) form.querySelector("span").textContent = title;
  form.addEventListener("submit", async (event) => {{
    event.preventDefault();
    const answer = await ask(path, {{ ...Object.fromEntries(new FormData(form)), ...extra }});
    if (answer.ok) then(said); else said.textContent = (await answer.json()).error;
  }});
}}
const enter = () => location.replace("/");
if (code) ask("/invitation", {{ code }}).then(async (answer) => {{
  const heard = await answer.json();
  if (answer.ok) show("invitation", heard.name, "/invitation/accept", {{ code }}, enter);
  else {{ show("login", "", "/login", {{}}, enter);
    document.querySelector("#login p").textContent = heard.error; }}
}});
else if (person) show("account", person, "/password", {{}},
  (said) => {{ said.textContent = "Changed; you are logged out everywhere else."; }});
else show("login", "", "/login", {{}}, enter);
document.getElementById("logout").addEventListener("click", async () => {{
  await ask("/logout", {{}}); location.replace("/login"); }});
</script></body></html>
"""

_ANSWER = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>ArtiWorld: log in</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style nonce="{nonce}">{style}</style></head><body>
<form><h1>ArtiWorld</h1><p role="alert">{problem}</p><a class="button" href="{target}">Go on</a>
</form><script nonce="{nonce}">{wait}</script></body></html>
"""


def answer_page(problem: str = "") -> tuple[bytes, str]:
    """Return the page after a login with the provider, and its policy: it goes on by itself.

    A redirect wouldn't do: browsers keep strict cookies to themselves until a page of the same
    site leads on.

    Args:
        problem: why nobody is logged in, or "".
    """
    nonce = secrets.token_urlsafe(16)
    page = _ANSWER.format(
        nonce=nonce,
        style=page_style(),
        problem=html.escape(problem),
        target="/login" if problem else "/",
        wait="" if problem else "location.replace('/');",
    )
    return page.encode(), page_policy(nonce)


def account_page(name: str, provider: str = "") -> tuple[bytes, str]:
    """Return the page and its content security policy.

    Args:
        name: who is logged in, or "".
        provider: label of the button to the organisation's provider; "" for none.
    """
    nonce = secrets.token_urlsafe(16)
    person = json.dumps(name).replace("<", "\\u003c")
    link = f'<a class="button" href="{API}/oidc/login">{html.escape(provider)}</a>'
    page = _ACCOUNT_PAGE.format(
        nonce=nonce,
        style=page_style(),
        api=json.dumps(API),
        person=person,
        provider=link if provider else "",
    )
    return page.encode(), page_policy(nonce)
