"""Logging in: the token, the cookie that proves it, the page that asks for it, and the page of
people with accounts.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from pathlib import Path

from cachetools import TTLCache
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
        self._failures = TTLCache[str, list[float]](_ADDRESSES_KEPT, ATTEMPT_SECONDS)

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
        recent = [t for t in self._failures.pop(key, []) if now - t < ATTEMPT_SECONDS]
        self._failures[key] = [*recent, now]


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
        return any(
            hmac.compare_digest(secret.encode("utf-8", "replace"), self._session.encode())
            for secret in secrets_in(cookies, port)
        )

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


def secrets_in(cookies: list[str], port: int) -> list[str]:
    """Return the secrets in the cookies of this server."""
    # Not http.cookies, which stops at the first malformed cookie of another local program.
    pairs = [pair.strip().partition("=") for pair in ";".join(cookies).split(";")]
    return [value for name, _, value in pairs if name == cookie_name(port) and value]


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(24)


def login_page(kind: str, **values: str) -> tuple[bytes, str]:
    """Return a page, and the content security policy that allows its script only.

    Args:
        kind: "token" or "account" asks for it. "answer" goes on by itself after a login with the
            provider: with a redirect browsers would keep strict cookies to themselves.
        values: ``problem``, why nobody is logged in; ``person``, who is; ``provider``, label of
            the button to the organisation's provider.
    """
    nonce = secrets.token_urlsafe(16)
    template = Template(TEMPLATE.read_text(encoding="utf-8"), autoescape=True)
    policy = (
        f"default-src 'none'; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; "
        "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    )
    return template.render(kind=kind, nonce=nonce, api=API, **values).encode(), policy
