"""Logging in: the token, the cookie that proves it, the page that asks for it, and the page of
people with accounts.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections import OrderedDict
from pathlib import Path

from jinja2 import Template

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
TEMPLATE = Path(__file__).with_name("login.html")


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

    def failed(self, key: str) -> None:
        """Note a wrong one."""
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
    return _page("token", problem=problem)


def answer_page(problem: str = "") -> tuple[bytes, str]:
    """Return the page after a login with the provider, and its policy: it goes on by itself.

    A redirect wouldn't do: browsers keep strict cookies to themselves until a page of the same
    site leads on.

    Args:
        problem: why nobody is logged in, or "".
    """
    return _page("answer", problem=problem)


def account_page(name: str, provider: str = "") -> tuple[bytes, str]:
    """Return the page and its content security policy.

    Args:
        name: who is logged in, or "".
        provider: label of the button to the organisation's provider; "" for none.
    """
    return _page("account", person=name, provider=provider, api=API)


def _page(kind: str, **values: str) -> tuple[bytes, str]:
    nonce = secrets.token_urlsafe(16)
    template = Template(TEMPLATE.read_text(encoding="utf-8"), autoescape=True)
    policy = (
        f"default-src 'none'; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    )
    return template.render(kind=kind, nonce=nonce, **values).encode(), policy
