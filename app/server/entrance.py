"""Entrance by an account, by the server's token, or to everybody of this machine, and from which
pages, by the headers that browsers set.

Accounts take over from the token as soon as there is one, also while the server runs.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from app.server.login import Attempts, Login, OidcLogin, secrets_in
from app.server.network import is_loopback
from model.core.errors import ConfigurationError
from sessions.accounts import TooManyAttempts
from sessions.credentials import SCOPES, Person
from sessions.people import People


class Origins:
    """The names of one server.

    Args:
        host: address that it listens at.
        allowed: its other addresses behind a proxy.

    Attributes:
        port: that it listens at, once that is known.
    """

    def __init__(self, host: str, allowed: tuple[str, ...] = ()) -> None:
        self._host = host
        self._trusted = {_netloc(urlsplit(origin).netloc) for origin in allowed}
        self.port = 0

    def problem(self, headers: Callable[[str], list[str]], *, login: bool) -> str | None:
        """Return why a request is from another site's page, or None.

        Browsers send these headers truthfully. ``Host`` reveals DNS rebinding: another name that
        points at this machine. With a login the cookie does that, as it belongs to one name.

        Args:
            headers: gives the values of a header.
            login: whether visitors have to log in.
        """
        hosts, origins = headers("Host"), headers("Origin")
        if len(hosts) != 1 or len(origins) > 1 or not is_plain_netloc(hosts[0]):
            return "bad Host or Origin header"
        host = _netloc(hosts[0])
        if not login and not self._is_own_name(host):
            return f"this server isn't called {hosts[0]}; open it as http://127.0.0.1:{self.port}"
        if origins:
            scheme, _, origin = origins[0].partition("://")
            if scheme not in ("http", "https") or _netloc(origin) not in {host, *self._trusted}:
                return f"pages of {origins[0]} may not use this server"
        sites, modes = headers("Sec-Fetch-Site"), headers("Sec-Fetch-Mode")
        elsewhere = bool({"cross-site", "same-site"} & set(sites)) and not origins
        if elsewhere and modes != ["navigate"]:
            return "another site's page may not use this server"
        return None

    def _is_own_name(self, netloc: str) -> bool:
        name = netloc.rpartition(":")[0] if netloc.rpartition(":")[2].isdigit() else netloc
        return is_loopback(name) or name == self._host.lower() or netloc in self._trusted


def is_plain_netloc(text: str) -> bool:
    """True if ``text`` is a host with or without a port, and nothing else."""
    return bool(text) and all(c.isalnum() or c in "-._:[]" for c in text) and text.isascii()


def _netloc(text: str) -> str:
    """Return host and port in lower case, without a default port."""
    return text.lower().removesuffix(":80").removesuffix(":443")


CHECK_SECONDS = 1.0
"""Period of asking whether accounts were made meanwhile, as on the command line."""


class Entrance:
    """Finds out who a visitor is. Methods may be called from any thread.

    Args:
        people: accounts of the workspace; None: there are none.
        login: the token, which counts while there are no accounts.
        user: name of everybody then.
        oidc: logs people in with an organisation's provider; everybody has to log in then.

    Attributes:
        oidc: as given.
        tabs: id of a connected browser tab → whose it is.
    """

    def __init__(
        self,
        people: People | None,
        login: Login,
        user: str = "",
        oidc: OidcLogin | None = None,
    ) -> None:
        self._people, self._login, self._user, self.oidc = people, login, user, oidc
        self.tabs: dict[int, Person] = {}
        self._attempts = Attempts()
        self._lock = threading.Lock()
        self._with_accounts, self._checked = oidc is not None, -CHECK_SECONDS

    @property
    def with_accounts(self) -> bool:
        """True if people log in by name; stays True, as accounts are never removed."""
        if self._people is not None and not self._with_accounts:
            now = time.monotonic()
            if now - self._checked >= CHECK_SECONDS:
                self._with_accounts, self._checked = self._people.accounts.in_use(), now
        return self._with_accounts

    @property
    def needed(self) -> bool:
        """True if a visitor has to authenticate."""
        return self.with_accounts or self._login.needed

    def visitor(self, cookies: list[str], port: int) -> Person | None:
        """Return whom the ``Cookie`` headers prove; None: nobody."""
        if not self.with_accounts or self._people is None:
            return self._everybody() if self._login.knows(cookies, port) else None
        for secret in secrets_in(cookies, port)[:4]:
            person = self._people.credentials.session(secret)
            if person is not None:
                return person
        return None

    def bearer(self, secret: str, address: str) -> Person | None:
        """Return whose token ``secret`` is; None: nobody's."""
        if self.with_accounts and self._people is not None:
            return self._people.credentials.token(secret)
        if not self._login.needed:
            return None
        with self._lock:  # Login isn't thread-safe
            return self._everybody() if self._login.try_token(secret, address) else None

    def log_in(self, name: str, password: str, address: str) -> str:
        """Check name and password; returns the secret of a new browser session.

        Unknown names, disabled accounts and wrong passwords take the same work and get the same
        answer.

        Raises:
            ConfigurationError: where they don't belong to an account.
            TooManyAttempts: after many wrong ones for the address or for the name.
        """
        people = self._people
        if people is None or not self.with_accounts:
            raise ConfigurationError("there are no accounts here; see artiworld user add")
        keys = (f"address {address}", f"name {name.casefold()[:80]}")
        with self._lock:
            if any(self._attempts.guessing(key) for key in keys):
                raise TooManyAttempts("Too many wrong passwords; wait a minute.")
            for key in keys:  # those that wait count, too
                self._attempts.failed(key)
        account = people.accounts.check(name, password)
        if account is not None:
            with self._lock:
                for key in keys:
                    self._attempts.right(key)
            return people.credentials.begin_session(account, address)
        # A password is typed into the wrong box now and then, so unknown names aren't kept.
        known = any(a.name.casefold() == name.casefold() for a in people.accounts.all())
        people.audit.add("login_failed", "", name if known else "unknown name", address=address)
        raise ConfigurationError("Name or password is wrong.")

    def forget_tab(self, left: Any) -> None:
        """Drop whose browser tab it was; viser gives the connection that ended."""
        self.tabs.pop(left.client_id, None)

    def session(self, secret: str) -> Person | None:
        """Return who has that browser session now; None where it ended."""
        return None if self._people is None else self._people.credentials.session(secret)

    def _everybody(self) -> Person:
        return Person(None, self._user, frozenset(SCOPES))
