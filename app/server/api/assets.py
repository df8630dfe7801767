"""Assets: the accepted objects as files."""

from __future__ import annotations

import io
import secrets
import shutil
import zipfile
from pathlib import Path
from typing import Any

from fastapi import APIRouter, HTTPException
from fastapi.responses import Response

from app.server.api.guard import Reader, State
from app.server.api.objects import record_of, wait
from app.server.export_tasks import ExportTask, export_one
from model.io.export.registry import exporter_names
from model.physics.simulation_values import PhysicsSettings

router = APIRouter(tags=["assets"])
DOWNLOAD_BYTES = 400_000_000
"""Largest download: it passes through the memory of the server."""


@router.get("/assets")
def list_assets(person: Reader, state: State) -> dict[str, Any]:
    """All accepted objects that have an asset, and the formats in which it can be had."""
    found = []
    for record in state.queue.records():
        if record.state == "accepted":
            saved = state.session(record.id).document.saved
            if saved is not None and state.store.assets.has(saved):
                found.append({
                    "id": record.id, "name": record.name, "category": record.category,
                    "accepted_by": saved.by, "at": saved.at,
                })  # fmt: skip
    return {"formats": ["asset", *exporter_names()], "assets": found}


@router.get("/assets/{object_id}")
def download(object_id: int, person: Reader, state: State, format: str = "asset") -> Response:
    """Download an asset as a zip: "asset" as it was accepted, or in a simulator's format."""
    name = record_of(state, object_id).name
    if format not in ("asset", *exporter_names()):
        raise HTTPException(422, f"format: one of asset, {', '.join(exporter_names())}")
    folder = state.store.assets.folder(state.session(object_id).document.saved)
    if folder is None:
        raise HTTPException(404, "the object has no asset: it wasn't accepted yet")
    if format == "asset":
        return _zipped(folder, name)
    out = state.workspace / "exports" / f".{secrets.token_hex(8)}"
    task = ExportTask(
        folder, ((format, out),), PhysicsSettings(), state.workspace / "collision", check=False
    )
    try:
        job = state.workers.saving.submit(export_one, task, priority=-1)
        try:
            wait(lambda: job.done)
        except HTTPException:
            job.cancel()
            raise
        job.result(0)
        return _zipped(out, f"{name}_{format}")
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _zipped(folder: Path, name: str) -> Response:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    if sum(p.stat().st_size for p in files) > DOWNLOAD_BYTES:
        raise HTTPException(413, "the asset is too large to download; copy it from the server")
    plain = "".join(c if c.isalnum() or c in "._-" else "_" for c in name)[:80] or "asset"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in files:
            archive.write(path, Path(plain) / path.relative_to(folder))
    quoted = plain.encode("ascii", "replace").decode().replace("?", "_")
    headers = {"Content-Disposition": f'attachment; filename="{quoted}.zip"'}
    return Response(buffer.getvalue(), media_type="application/zip", headers=headers)
