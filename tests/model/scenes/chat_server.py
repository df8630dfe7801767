"""A server on this machine that speaks OpenAI's chat protocol, well or badly."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

MOVES = ("cabinet", "fridge", "oven")


def decisions(objects: list[dict[str, Any]]) -> str:
    """What a sensible model says."""
    said = []
    for id, text in ((o["id"], o["description"]) for o in objects):
        found = {"id": id, "reason": f"{text} seen", "kind": text.split()[-1]}
        moves = any(w in text for w in MOVES)
        said.append({**found, "articulable": moves, "parts": ["door"], "base": "fixed"})
    return json.dumps({"objects": said})


Reply = tuple[int, dict[str, str], bytes]
"""Status, headers, body."""


def said(text: str, **more: Any) -> Reply:
    message = {"role": "assistant", "content": text}
    body = {"id": "x", "object": "chat.completion", "created": 0, "model": "m"}
    body |= {"choices": [{"index": 0, "finish_reason": "stop", "message": message}]}
    body |= {"usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110}, **more}
    return 200, {"content-type": "application/json"}, json.dumps(body).encode()


def fault(status: int, message: str = "no") -> Reply:
    """An error after which the client tries again at once, where it tries again at all."""
    body = json.dumps({"error": {"message": message, "type": "t", "code": None}}).encode()
    return status, {"content-type": "application/json", "retry-after-ms": "1"}, body


class ChatServer:
    """Attributes:
    url: for clients. requests: bodies in the order of their coming. keys: what came with them.
    script: what to do with a request's body and objects; raising closes the connection.
    """

    def __init__(self) -> None:
        self.requests: list[dict[str, Any]] = []
        self.keys: list[str] = []
        self.script: Callable[[dict[str, Any], list[dict[str, Any]]], Reply]
        self.script = lambda body, objects: said(decisions(objects))
        self.url = ""


@contextmanager
def chat_server() -> Iterator[ChatServer]:
    state, lock = ChatServer(), threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["content-length"])))
            with lock:
                state.requests.append(body)
                state.keys.append(self.headers.get("authorization", ""))
            if self.path != "/v1/chat/completions":
                reply = fault(404, "no such route")
            else:
                reply = state.script(body, json.loads(body["messages"][-1]["content"]))
            status, headers, data = reply
            try:
                self.send_response(status)
                for name, value in {**headers, "content-length": str(len(data))}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(data)
            except OSError:
                return  # the client has given up

        def log_message(self, *_: object) -> None:
            return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.handle_error = lambda *_: None  # type: ignore[method-assign]
    state.url = f"http://127.0.0.1:{server.server_address[1]}/v1"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield state
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
