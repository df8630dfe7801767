"""The project: its settings for all who work on it; statistics of how long people worked, what they
did and what it cost; and webhooks, whose signed messages go to public addresses only.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import http.client
import ipaddress
import logging
import math
import socket
import ssl
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Literal
from urllib.parse import SplitResult, quote, urlsplit

from fastapi import APIRouter, HTTPException, Query
from pydantic import BaseModel, Field

from app.server.api.guard import Id, Json, LongRouter, Manager, Reader, State
from model.core import codec
from model.core.errors import ConfigurationError, StoreError
from model.core.progress import each
from sessions.command_log import read_work
from sessions.statistics import acts_of, grouped, rows_of
from sessions.webhooks import Delivery, Webhooks

project_router = APIRouter(tags=["project"])


class SettingsBody(BaseModel):
    """Settings that change; what is left out stays."""

    settings: dict[str, Any] = Field(min_length=1)


@project_router.get("/project")
def project(person: Reader, state: State) -> Json:
    """Name, instructions, labels, required checks and export settings."""
    return codec.write(state.store.project.settings)


@project_router.patch("/project")
def change(body: SettingsBody, person: Manager, state: State) -> Json:
    """Change settings; returns all of them."""
    settings = state.store.project.change(body.settings, person.name)
    state.queue.changed()
    return codec.write(settings)


statistics_router = LongRouter(tags=["statistics"])


@statistics_router.get("/statistics")
def statistics(
    person: Manager,
    state: State,
    by: Literal["person", "category", "predictor", "step", "object", "day"] = "person",
    since: float | None = None,
    rate: float | None = Query(None, gt=0),
) -> list[Json]:
    """Figures for each person, category, …; ``since`` in Unix seconds, ``rate`` for an hour."""
    log = read_work(state.workspace, state.config.database)
    figures = grouped(log, acts_of(log), by, -math.inf if since is None else since)
    return rows_of(figures, by, rate)


log = logging.getLogger(__name__)
SECONDS = 10.0
"""Longest time of one delivery: that to connect, and that of all the rest."""
SENDERS = 8
"""Webhooks that are sent something at a time: one that is slow holds up its own alone."""
PERIOD = 2.0
"""Seconds between two looks for messages that are due; a closing sender waits as long."""
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
    """Delivers messages, each webhook's one after the other, until it is closed.

    Args:
        allowed: says which addresses may be sent to.
    """

    def __init__(self, hooks: Webhooks, allowed: Callable[[Address], bool] = is_public) -> None:
        self._hooks, self._allowed = hooks, allowed
        self._closed, self._look = threading.Event(), threading.Event()
        self._busy: dict[int, threading.Thread] = {}
        self._loop = threading.Thread(target=self._run, name="webhooks", daemon=True)
        self._loop.start()

    def close(self) -> None:
        """Wait a moment for what is being sent; the next server sends the rest."""
        self._closed.set()
        self._look.set()
        self._loop.join(PERIOD)  # first, as it adds to the others
        end = time.monotonic() + PERIOD
        for thread in tuple(self._busy.values()):
            thread.join(max(0.0, end - time.monotonic()))

    def _run(self) -> None:
        while not self._closed.is_set():
            self._look.clear()
            try:
                free = len(self._busy) < SENDERS
                delivery = self._hooks.claim(tuple(self._busy)) if free else None
            except Exception as error:  # a thread's boundary; it is tried again
                log.warning("webhooks wait: %s", error)
                delivery = None
            if delivery is None:
                self._look.wait(PERIOD)
                continue
            sender = threading.Thread(target=self._send, args=(delivery,), daemon=True)
            self._busy[delivery.webhook] = sender
            sender.start()

    def _send(self, delivery: Delivery) -> None:
        try:
            send(self._hooks, delivery, self._allowed)
        except StoreError as error:  # it is claimed again later
            log.warning("webhooks wait: %s", error)
        finally:
            self._busy.pop(delivery.webhook)
            self._look.set()


def send(
    hooks: Webhooks, delivery: Delivery, allowed: Callable[[Address], bool] = is_public
) -> None:
    """Try one delivery, and note how it went."""

    def one(delivery: Delivery) -> None:
        status = _post(delivery, allowed)
        if not 200 <= status < 300:
            raise ConfigurationError(f"the receiver answered {status}")
        hooks.delivered(delivery)

    each([delivery], one, lambda d, error: hooks.failed(d, str(error) or type(error).__name__))


def _post(delivery: Delivery, allowed: Callable[[Address], bool]) -> int:
    parts, address = check_url(delivery.url, allowed)
    assert parts.hostname is not None
    secure = parts.scheme == "https"
    kind = http.client.HTTPSConnection if secure else http.client.HTTPConnection
    connection = kind(parts.hostname, parts.port, timeout=SECONDS)
    # The address that was checked, under the name that the certificate and Host are for.
    plain = socket.create_connection((address, connection.port), SECONDS)
    # All of it together: a receiver could answer a byte within each time-out.
    begun, end = time.monotonic(), threading.Timer(SECONDS, _cut, (connection,))
    try:
        connection.sock = plain
        end.start()
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
        target = quote(target, safe="/?&=%+:@!$'()*,;~-._[]")
        connection.request("POST", target, body, headers)
        return connection.getresponse().status
    except (OSError, http.client.HTTPException) as error:
        slow = time.monotonic() - begun >= SECONDS
        text = f"the receiver took more than {SECONDS:g} s" if slow else str(error)
        raise OSError(text or type(error).__name__) from error
    finally:
        end.cancel()
        connection.close()
        plain.close()


def _cut(connection: http.client.HTTPConnection) -> None:
    with contextlib.suppress(OSError, AttributeError):
        connection.sock.shutdown(socket.SHUT_RDWR)


webhooks_router = LongRouter(tags=["webhooks"])


class WebhookBody(BaseModel):
    """Address and events of a webhook."""

    url: str = Field(max_length=1000)
    events: list[str] = Field(min_length=1, max_length=50)


@webhooks_router.get("/webhooks")
def webhooks(person: Manager, state: State) -> list[Json]:
    """All webhooks, with what waits for them and why."""
    return [asdict(hook) for hook in state.store.people.webhooks.all()]


@webhooks_router.post("/webhooks", status_code=201)
def add(body: WebhookBody, person: Manager, state: State) -> Json:
    """Add a webhook at a public address; the secret that signs its messages is shown once."""
    if person.account is None:
        raise HTTPException(409, "webhooks belong to accounts, and there are none here")
    check_url(body.url)
    hooks = state.store.people.webhooks
    return {"secret": hooks.add(person.account, body.url, body.events, person.name)}


@webhooks_router.delete("/webhooks/{webhook_id}")
def remove(webhook_id: Id, person: Manager, state: State) -> Json:
    """Remove a webhook and what waits for it."""
    state.store.people.webhooks.remove(webhook_id, person.name)
    return {"removed": webhook_id}
