"""Logging in: the token, the cookie that proves it, the page that asks for it, the page of people
with accounts; and login with an organisation's OpenID Connect provider.

The latter is the code flow with PKCE, state and nonce, after OpenID Connect Core 1.0 (sections
3.1.2 and 3.1.3.7), RFC 7636 and RFC 9207. What the provider says is believed only as a signed ID
token for this server and this login.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote_plus, urlsplit

from cachetools import TTLCache
from jinja2 import Template

from app.server.network import API, is_loopback
from model.core.errors import ConfigurationError
from model.core.packages import install_command
from sessions.accounts import Account
from sessions.people import People
from sessions.review import ROLES, Role

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


SECRET_VARIABLE = "ARTIWORLD_OIDC_SECRET"
"""Environment variable that may hold the client's secret."""
ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "EdDSA")
"""Signatures with a public key; neither "none" nor such that the client's secret signs."""
SECONDS = 10.0
"""Longest wait for an answer of the provider."""
KEPT_SECONDS, AGAIN_SECONDS = 3600.0, 60.0
"""Lifetime of the provider's description and keys, and shortest time after which they are read
again where a token has another key."""
LEEWAY = 60
"""Seconds that clocks may differ."""
SCOPE = "openid profile email"


class OidcError(ConfigurationError):
    """A login with the provider failed."""


@dataclass(frozen=True)
class OidcSettings:
    """Settings for login with an organisation's OpenID Connect provider.

    Attributes:
        issuer: address of the provider, whose description is at ``/.well-known`` below it.
        client: id under which this server is registered there.
        secret: the client's secret; None for a public client.
        name_claim: claim of the ID token that names a person at the first login.
        role_claim: claim that holds roles, a word or a list; None: roles are set here.
        anybody: whether people without an invitation get an account as annotators.
        label: of the button.

    Raises:
        ConfigurationError: where an address is unusable, or a package is missing.
    """

    issuer: str
    client: str
    secret: str | None = None
    name_claim: str = "preferred_username"
    role_claim: str | None = None
    anybody: bool = False
    label: str = "Log in with your organisation"

    def __post_init__(self) -> None:
        _check_address(self.issuer, "--oidc-issuer")
        try:
            import authlib  # noqa: F401
            import httpx  # noqa: F401
        except ImportError as error:
            command = install_command("artiworld[oidc]")
            raise ConfigurationError(f"--oidc-issuer needs a package; run: {command}") from error


class OidcLogin:
    """Sends people to the provider and checks what they come back with. Thread-safe.

    Args:
        settings: of the provider.
        people: of the workspace.
    """

    def __init__(self, settings: OidcSettings, people: People) -> None:
        self.settings, self._people = settings, people
        self._lock = threading.Lock()
        self._known: tuple[float, dict[str, Any], Any] | None = None

    def begin(self, redirect: str) -> tuple[str, str]:
        """Return the provider's address for a person, and a secret for the browser's cookie.

        Args:
            redirect: address to which the provider sends the person back.
        """
        from authlib.oauth2.rfc6749.parameters import prepare_grant_uri
        from authlib.oauth2.rfc7636 import create_s256_code_challenge

        state, browser, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(4))
        metadata, _ = self._provider()
        address = prepare_grant_uri(
            metadata["authorization_endpoint"],
            self.settings.client,
            "code",
            redirect_uri=redirect,
            scope=SCOPE,
            state=state,
            nonce=nonce,
            code_challenge=create_s256_code_challenge(verifier),
            code_challenge_method="S256",
        )
        self._people.identities.begin(state, browser, nonce, verifier)
        return address, browser

    def finish(self, answer: Mapping[str, str], browser: str, redirect: str) -> Account:
        """Return the account of a person who comes back.

        Args:
            answer: parameters of the address.
            browser: value of the cookie.

        Raises:
            OidcError: where the answer isn't for this login, or isn't the provider's.
            ConfigurationError: where the person has no account here.
        """
        begun = self._people.identities.take(answer.get("state", ""), browser)
        if begun is None:
            raise OidcError("This login has expired or was used; begin again.")
        nonce, verifier = begun
        metadata, _ = self._provider()
        if answer.get("iss", metadata["issuer"]) != metadata["issuer"]:
            raise OidcError("The answer comes from another provider.")
        if "code" not in answer:
            why = answer.get("error", "no code")[:80]
            raise OidcError(f"The provider refused the login: {why}.")
        claims = self._claims(self._token(answer["code"], verifier, redirect), nonce)
        name = claims.get(self.settings.name_claim)
        unproven = self.settings.name_claim == "email" and claims.get("email_verified") is not True
        if not isinstance(name, str) or not name or unproven:
            raise OidcError(f"The provider says no {self.settings.name_claim} of yours.")
        return self._people.identities.account(
            metadata["issuer"],
            claims["sub"],
            name,
            self._role(claims),
            anybody=self.settings.anybody,
        )

    def _token(self, code: str, verifier: str, redirect: str) -> str:
        """Exchange a code for an ID token."""
        import httpx

        metadata, _ = self._provider()
        client, secret = self.settings.client, self.settings.secret
        fields = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": redirect,
            "code_verifier": verifier,
        }
        proof: Any = None
        if secret is None:
            fields["client_id"] = client
        else:  # RFC 6749, 2.3.1: both are encoded as in a form
            proof = httpx.BasicAuth(quote_plus(client), quote_plus(secret))
        try:
            with httpx.Client(timeout=SECONDS) as session:
                answer = session.post(metadata["token_endpoint"], data=fields, auth=proof)
                token = answer.raise_for_status().json()["id_token"]
        except (httpx.HTTPError, ValueError, KeyError, TypeError) as error:
            raise OidcError("The provider doesn't take the code of this login.") from error
        if not isinstance(token, str):
            raise OidcError("The provider sent no ID token.")
        return token

    def _claims(self, token: str, nonce: str) -> dict[str, Any]:
        """Check an ID token (OpenID Connect Core, 3.1.3.7); returns its claims."""
        from joserfc import errors, jwt

        metadata, keys = self._provider()
        try:
            try:
                found = jwt.decode(token, keys, algorithms=list(ALGORITHMS))
            except ValueError:  # a key that isn't known yet
                _, keys = self._provider(again=True)
                found = jwt.decode(token, keys, algorithms=list(ALGORITHMS))
            jwt.JWTClaimsRegistry(
                leeway=LEEWAY,
                iss={"essential": True, "value": metadata["issuer"]},
                aud={"essential": True, "value": self.settings.client},
                exp={"essential": True},
                iat={"essential": True},
                sub={"essential": True},
                nonce={"essential": True, "value": nonce},
            ).validate(found.claims)
        except (errors.JoseError, ValueError, TypeError, KeyError) as error:
            raise OidcError("The provider's ID token is not valid for this login.") from error
        claims, several = found.claims, isinstance(found.claims["aud"], list)
        party = claims.get("azp", None if several and len(claims["aud"]) > 1 else "")
        if party not in ("", self.settings.client) or not isinstance(claims["sub"], str):
            raise OidcError("The provider's ID token is for another program.")
        return claims

    def _role(self, claims: Mapping[str, Any]) -> Role | None:
        """Highest known role that the provider names; annotator where it names none."""
        if self.settings.role_claim is None:
            return None
        named = claims.get(self.settings.role_claim)
        words = named.split() if isinstance(named, str) else named
        found: list[Role] = [r for r in ROLES if isinstance(words, list) and r in words]
        return found[-1] if found else ROLES[0]

    def _provider(self, *, again: bool = False) -> tuple[dict[str, Any], Any]:
        """The provider's description and its public keys."""
        with self._lock:
            now, kept = time.monotonic(), AGAIN_SECONDS if again else KEPT_SECONDS
            if self._known is None or now - self._known[0] > kept:
                self._known = (now, *self._read())
            return self._known[1], self._known[2]

    def _read(self) -> tuple[dict[str, Any], Any]:
        import httpx
        from joserfc.jwk import KeySet

        issuer = self.settings.issuer.rstrip("/")
        try:
            with httpx.Client(timeout=SECONDS) as client:
                answer = client.get(f"{issuer}/.well-known/openid-configuration")
                metadata = answer.raise_for_status().json()
                if metadata["issuer"].rstrip("/") != issuer:
                    raise ValueError(f"it calls itself {metadata['issuer']}")
                for name in ("authorization_endpoint", "token_endpoint", "jwks_uri"):
                    _check_address(metadata[name], name)
                keys = client.get(metadata["jwks_uri"]).raise_for_status().json()
            return metadata, KeySet.import_key_set(keys)
        except (httpx.HTTPError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise OidcError(f"{issuer} is no usable OpenID Connect provider ({error})") from error


def _check_address(address: str, what: str) -> None:
    found = urlsplit(address)
    safe = found.scheme == "https" or (found.scheme == "http" and is_loopback(found.hostname or ""))
    if not safe or not found.hostname or found.query or found.fragment:
        raise ConfigurationError(f"{what} {address} must be an address that begins with https://")
