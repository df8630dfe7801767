"""Same-origin check of requests, by the headers that browsers set."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import urlsplit

from app.server.network import is_loopback


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
