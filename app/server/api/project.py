"""The project: its settings, for all who work on it."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, Field

from app.server.api.guard import Manager, Reader, State
from model.core import codec

router = APIRouter(tags=["project"])


class SettingsBody(BaseModel):
    """Settings that change; what is left out stays."""

    settings: dict[str, Any] = Field(min_length=1)


@router.get("/project")
def project(person: Reader, state: State) -> dict[str, Any]:
    """Name, instructions, labels, required checks and export settings."""
    return codec.write(state.store.project.settings)


@router.patch("/project")
def change(body: SettingsBody, person: Manager, state: State) -> dict[str, Any]:
    """Change settings; returns all of them."""
    settings = state.store.project.change(body.settings, person.name)
    state.queue.changed()
    return codec.write(settings)
