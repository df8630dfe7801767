"""Sends the messages of webhooks, signed, to public addresses only.

The name of an address is resolved once, each address that it has is checked, and the connection
goes to one that was checked, so that a name which changes in between leads nowhere else. Redirects
aren't followed.
"""

from __future__ import annotations

import hashlib
import hmac
import http.client
import ipaddress
import logging
import socket
import ssl
import threading
import time
from collections.abc import Callable
from urllib.parse import SplitResult, urlsplit

from model.core.errors import ConfigurationError, StoreError
from sessions.webhooks import Delivery, Webhooks

log = logging.getLogger(__name__)
SECONDS = 10.0
"""Longest wait for a receiver."""
PERIOD = 2.0
"""Seconds between two looks for messages that are due."""
SIGNATURE = "X-ArtiWorld-Signature"
_TRANSLATED = tuple(map(ipaddress.ip_network, ("64:ff9b::/96", "64:ff9b:1::/48", "2002::/16")))
"""IPv6 networks that stand for IPv4 addresses, which may be private."""

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def is_public(address: Address) -> bool:
    """True if an address is neither private, loopback, link-local nor otherwise special."""
    mapped = getattr(address, "ipv4_mapped", None)
    if mapped is not None:
        return is_public(mapped)
    if any(address in network for network in _TRANSLATED if network.version == address.version):
        return False
    return address.is_global and not address.is_multicast and not address.is_reserved


def check_url(url: str, allowed: Callable[[Address], bool] = is_public) -> tuple[SplitResult, str]:
    """Return the parts of a webhook's URL and an address of its host that was checked.

    Raises:
        ConfigurationError: where it isn't http or https, can't be resolved, or any address of the
            host isn't allowed.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise ConfigurationError(f"{url[:200]} is no address of a webhook ({error})") from error
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.username:
        raise ConfigurationError(
            f"{url[:200]} is no address of a webhook; give one like https://example.org/hook"
        )
    port = port or (443 if parts.scheme == "https" else 80)
    try:
        found = socket.getaddrinfo(parts.hostname, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise ConfigurationError(f"{parts.hostname} can't be resolved") from error
    addresses = [str(entry[4][0]).partition("%")[0] for entry in found]
    wrong = [a for a in addresses if not allowed(ipaddress.ip_address(a))]
    if wrong or not addresses:
        raise ConfigurationError(
            f"{parts.hostname} is not a public address; webhooks go to public ones only"
        )
    return parts, addresses[0]


def signature(secret: str, payload: bytes, at: int) -> str:
    """Return the header that proves who sent ``payload`` and when.

    Args:
        at: Unix time in seconds; a receiver refuses old ones, so that nothing is played again.
    """
    code = hmac.new(secret.encode(), b"%d." % at + payload, hashlib.sha256).hexdigest()
    return f"t={at},v1={code}"


class WebhookSender:
    """Delivers messages on a thread of its own until it is closed.

    Args:
        allowed: says which addresses may be sent to.
    """

    def __init__(self, hooks: Webhooks, allowed: Callable[[Address], bool] = is_public) -> None:
        self._hooks, self._allowed = hooks, allowed
        self._closed = threading.Event()
        threading.Thread(target=self._run, name="webhooks", daemon=True).start()

    def close(self) -> None:
        """Send no more; what waits is sent by the next server."""
        self._closed.set()

    def _run(self) -> None:
        while not self._closed.wait(PERIOD):
            try:
                for delivery in self._hooks.claim():
                    send(self._hooks, delivery, self._allowed)
                    if self._closed.is_set():
                        return
            except StoreError as error:
                if not self._closed.is_set():
                    log.warning("webhooks wait: %s", error)
            except Exception:  # a thread's boundary
                if not self._closed.is_set():
                    log.exception("sending webhooks failed")


def send(
    hooks: Webhooks, delivery: Delivery, allowed: Callable[[Address], bool] = is_public
) -> None:
    """Try one delivery, and note how it went."""
    try:
        status = _post(delivery, allowed)
    except (ConfigurationError, OSError, http.client.HTTPException) as error:
        hooks.failed(delivery, str(error) or type(error).__name__)
        return
    if 200 <= status < 300:
        hooks.delivered(delivery)
    else:
        hooks.failed(delivery, f"the receiver answered {status}")


def _post(delivery: Delivery, allowed: Callable[[Address], bool]) -> int:
    parts, address = check_url(delivery.url, allowed)
    assert parts.hostname is not None
    secure = parts.scheme == "https"
    kind = http.client.HTTPSConnection if secure else http.client.HTTPConnection
    connection = kind(parts.hostname, parts.port, timeout=SECONDS)
    # The address that was checked, under the name that the certificate and Host are for.
    plain = socket.create_connection((address, connection.port), SECONDS)
    try:
        connection.sock = plain
        if secure:
            context = ssl.create_default_context()
            connection.sock = context.wrap_socket(plain, server_hostname=parts.hostname)
        body = delivery.payload.encode()
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "ArtiWorld",
            "X-ArtiWorld-Event": delivery.event,
            "X-ArtiWorld-Delivery": str(delivery.id),
            SIGNATURE: signature(delivery.secret, body, int(time.time())),
        }
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        connection.request("POST", target, body, headers)
        return connection.getresponse().status
    finally:
        connection.close()
        plain.close()
