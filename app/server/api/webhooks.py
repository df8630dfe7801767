"""Webhooks: addresses that hear of decisions."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, HTTPException
from pydantic import BaseModel, Field

from app.server.api.guard import Manager, State
from app.server.webhook_sender import check_url

router = APIRouter(tags=["webhooks"])


class WebhookBody(BaseModel):
    """Address and events of a webhook."""

    url: str = Field(max_length=1000)
    events: list[str] = Field(min_length=1, max_length=50)


@router.get("/webhooks")
def webhooks(person: Manager, state: State) -> list[dict[str, Any]]:
    """All webhooks, with what waits for them and why."""
    return [asdict(hook) for hook in state.store.people.webhooks.all()]


@router.post("/webhooks", status_code=201)
def add(body: WebhookBody, person: Manager, state: State) -> dict[str, Any]:
    """Add a webhook at a public address; the secret that signs its messages is shown once."""
    if person.account is None:
        raise HTTPException(409, "webhooks belong to accounts, and there are none here")
    check_url(body.url)
    hooks = state.store.people.webhooks
    return {"secret": hooks.add(person.account, body.url, body.events, person.name)}


@router.delete("/webhooks/{webhook_id}")
def remove(webhook_id: int, person: Manager, state: State) -> dict[str, Any]:
    """Remove a webhook and what waits for it."""
    state.store.people.webhooks.remove(webhook_id, person.name)
    return {"removed": webhook_id}
