"""A server in a process of its own, each of whose workers is held by a job."""

from __future__ import annotations

import time
from pathlib import Path

from app.cli.serve import start_server
from app.server.config import ServeConfig
from app.server.ending import EndSignals
from app.server.network import free_port
from app.server.server import run_until_interrupted
from tests.app.job_functions import hold_the_interpreter


def serve(folder: str) -> None:
    end = EndSignals()
    config = ServeConfig(paths=(), workspace=Path(folder, "workspace"), port=free_port("127.0.0.1"))
    server = start_server(config)
    workers = server.app_state.workers
    held = [
        *workers.readers,
        workers.geometry,
        workers.segmentation,
        workers.prediction,
        workers.saving,
    ]
    started = [Path(folder, worker.name) for worker in held]
    for worker, mark in zip(held, started, strict=True):
        worker.submit(hold_the_interpreter, str(mark))
    while not all(mark.exists() for mark in started):
        time.sleep(0.01)
    run_until_interrupted(server, end)
