"""Webhooks: addresses that hear of decisions, and what is still to be delivered to them.

A delivery is stored in the transaction of its decision, so that none is lost and none is made up.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection, case, delete, func, insert, select, update

from model.core.errors import ConfigurationError
from sessions.account_tables import accounts, deliveries, record, webhooks
from sessions.accounts import Account, new_secret
from sessions.database import Database, now, objects

EVENT_OF: Mapping[str, str] = {
    "record_prediction": "object.predicted",
    "submit": "object.submitted",
    "accept": "object.accepted",
    "reject": "object.rejected",
    "reopen": "object.reopened",
    "saved": "asset.saved",
}
"""Stored name of a command → the event that it is."""
EVENTS: tuple[str, ...] = tuple(EVENT_OF.values())
MOST_ATTEMPTS = 8
FIRST_WAIT = 10.0
"""Seconds after the first failure; each further wait is four times as long: two days in all."""
CLAIM_SECONDS = 60.0
"""Longest time of one attempt, in which no other server tries the same delivery."""
KEPT_SECONDS = 30 * 86400.0
"""Time for which a message that couldn't be delivered stays in sight."""
MOST_WEBHOOKS = 50
_OPEN = deliveries.c.attempts < MOST_ATTEMPTS


@dataclass(frozen=True)
class Webhook:
    """An address that hears of decisions; its secret is shown once, when it is made.

    Attributes:
        waiting: deliveries that weren't made yet.
        problem: why the last attempt of one of them failed, or "".
        failed: deliveries that were set aside after :data:`MOST_ATTEMPTS`, for 30 days.
    """

    id: int
    account: str
    url: str
    events: tuple[str, ...]
    waiting: int
    problem: str
    failed: int


@dataclass(frozen=True)
class Delivery:
    """One message to send; ``attempts`` counts this one, too."""

    id: int
    webhook: int
    url: str = field(repr=False)
    secret: str = field(repr=False)
    event: str
    payload: str = field(repr=False)
    attempts: int


class Webhooks:
    """The webhooks of a workspace. Methods may be called from any thread."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, account: Account, url: str, events: Iterable[str], by: str) -> str:
        """Add a webhook; returns the secret that signs its messages.

        Raises:
            ConfigurationError: where an event is unknown, or there are too many webhooks.
        """
        asked = [event for event in EVENTS if event in set(events)]
        unknown = sorted(set(events) - set(EVENTS))
        if unknown or not asked:
            raise ConfigurationError(
                f"events must be of {', '.join(EVENTS)}; got {', '.join(unknown) or 'none'}"
            )
        secret = new_secret("aws_")
        with self._database.writing() as connection:
            count = connection.execute(select(func.count()).select_from(webhooks)).scalar() or 0
            if count >= MOST_WEBHOOKS:
                raise ConfigurationError(f"there are {count} webhooks already; remove one first")
            values = {"account_id": account.id, "url": url, "secret": secret, "created": now()}
            connection.execute(insert(webhooks).values(**values, events=" ".join(asked)))
            record(connection, "webhook_added", by, account.name, url)
        return secret

    def remove(self, webhook_id: int, by: str) -> None:
        """Remove a webhook and what waits for it.

        Raises:
            ConfigurationError: where there is none with that id.
        """
        with self._database.writing() as connection:
            connection.execute(delete(deliveries).where(deliveries.c.webhook_id == webhook_id))
            mine = webhooks.c.id == webhook_id
            url = connection.execute(select(webhooks.c.url).where(mine)).scalar()
            if url is None:
                raise ConfigurationError(f"there is no webhook {webhook_id}")
            connection.execute(delete(webhooks).where(mine))
            record(connection, "webhook_removed", by, f"webhook {webhook_id}", url)

    def all(self) -> list[Webhook]:
        """Return all webhooks."""
        waiting = (
            select(
                deliveries.c.webhook_id,
                func.count().label("all"),
                func.max(deliveries.c.problem).label("problem"),
                func.sum(case((_OPEN, 0), else_=1)).label("failed"),
            )
            .group_by(deliveries.c.webhook_id)
            .subquery()
        )
        wanted = (
            select(webhooks, accounts.c.name, waiting.c.all, waiting.c.problem, waiting.c.failed)
            .join(accounts, webhooks.c.account_id == accounts.c.id)
            .join(waiting, waiting.c.webhook_id == webhooks.c.id, isouter=True)
            .order_by(webhooks.c.id)
        )
        with self._database.reading() as connection:
            rows = connection.execute(wanted).all()
        return [
            Webhook(
                *(r.id, r.name, r.url, tuple(r.events.split())),
                *((r.all or 0) - (r.failed or 0), r.problem or "", r.failed or 0),
            )
            for r in rows
        ]

    def claim(self, busy: Collection[int] = ()) -> Delivery | None:
        """Return the message that is due longest, if any; no other server gets it for a while.

        The attempt counts from now on, so that one that ends the server counts, too.

        Args:
            busy: webhooks that are left out: they are being sent something.
        """
        wanted = (
            select(deliveries, webhooks.c.url, webhooks.c.secret)
            .join(webhooks, deliveries.c.webhook_id == webhooks.c.id)
            .where(deliveries.c.due <= now(), _OPEN, deliveries.c.webhook_id.not_in(busy))
            .order_by(deliveries.c.due)
            .limit(1)
        )
        with self._database.reading() as connection:
            row = connection.execute(wanted).one_or_none()
        if row is None:
            return None
        mine = (deliveries.c.id == row.id) & (deliveries.c.due == row.due)
        values = {"due": now(CLAIM_SECONDS), "attempts": row.attempts + 1}
        with self._database.writing() as connection:
            if connection.execute(update(deliveries).where(mine).values(values)).rowcount != 1:
                return None  # another server was first
        texts = row.url, row.secret, row.event, row.payload
        return Delivery(row.id, row.webhook_id, *texts, row.attempts + 1)

    def delivered(self, delivery: Delivery) -> None:
        """Note that a message arrived."""
        with self._database.writing() as connection:
            connection.execute(delete(deliveries).where(deliveries.c.id == delivery.id))

    def failed(self, delivery: Delivery, problem: str) -> None:
        """Note that an attempt failed; after :data:`MOST_ATTEMPTS` the message is set aside."""
        old = ~_OPEN & (deliveries.c.due < now(-KEPT_SECONDS))
        due = now(FIRST_WAIT * 4 ** (delivery.attempts - 1))
        values = {"due": due, "problem": problem[:300]}
        with self._database.writing() as connection:
            connection.execute(delete(deliveries).where(old))
            mine = deliveries.c.id == delivery.id
            connection.execute(update(deliveries).where(mine).values(values))


def enqueue(connection: Connection, line: Mapping[str, Any]) -> None:
    """Store the messages about the command ``line``, in its transaction."""
    event = EVENT_OF.get(line["kind"])
    if event is None:
        return
    hooks = connection.execute(select(webhooks.c.id, webhooks.c.events)).all()
    wanted = [hook.id for hook in hooks if event in hook.events.split()]
    if not wanted:
        return
    of = objects.c.id == line["object_id"]
    name = connection.execute(select(objects.c.name).where(of)).scalar()
    payload = json.dumps(
        {
            "event": event,
            "object": line["object_id"],
            "name": name,
            "seq": line["seq"],
            "at": line["at"],
            "who": line["who"],
        }
    )
    values = {"event": event, "payload": payload, "attempts": 0, "due": now(), "problem": ""}
    connection.execute(insert(deliveries), [{"webhook_id": i, **values} for i in wanted])
