"""A server with accounts, and clients that log in like a browser or with a token."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from app.cli.serve import start_server
from app.client import Client
from app.server.config import ServeConfig
from app.server.server import Server
from sessions.store import Store
from tests.sessions.people import PASSWORD, add_people


@contextmanager
def team_server(
    folder: Path, *paths: Path, accounts: bool = True, **settings: Any
) -> Iterator[Server]:
    """A server of ``paths``, with the accounts of :func:`add_people`."""
    if accounts:
        store = Store(folder)
        add_people(store)
        store.close()
    server = start_server(ServeConfig(paths=paths, workspace=folder, port=0, **settings))
    try:
        yield server
    finally:
        server.close()


class Browser:
    """Requests with cookies, without redirects, so that each answer is seen."""

    def __init__(self, server: Server) -> None:
        self.port = server.viser.get_port()
        self.cookie: str | None = None

    def ask(
        self, method: str, path: str, body: Any = None, own: bool = True, **headers: str
    ) -> tuple[int, Any]:
        """Return status and JSON (or bytes) of the answer."""
        fields = {name.replace("_", "-"): value for name, value in headers.items()}
        if own:
            fields["X-ArtiWorld"] = "1"
        if self.cookie:
            fields["Cookie"] = self.cookie
        data = None if body is None else json.dumps(body).encode()
        if data is not None:
            fields["Content-Type"] = "application/json"
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request(method, path, data, fields)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        if answer.headers["Set-Cookie"]:
            self.cookie = answer.headers["Set-Cookie"].partition(";")[0]
        kind = answer.headers.get("Content-Type", "")
        return answer.status, json.loads(content) if kind == "application/json" else content

    def api(self, method: str, path: str, body: Any = None, **settings: Any) -> tuple[int, Any]:
        """Ask a route of the API."""
        return self.ask(method, f"/api/v1{path}", body, **settings)

    def log_in(self, name: str, password: str = PASSWORD) -> int:
        """Log in; returns the status."""
        return self.api("POST", "/login", {"name": name, "password": password})[0]


def token_client(server: Server, name: str, *scopes: str) -> Client:
    """A client with a token of that account and those scopes."""
    people = server.app_state.store.people
    secret = people.credentials.make_token(people.accounts.find(name), "test", scopes)
    return Client(f"http://127.0.0.1:{server.viser.get_port()}", secret)
