"""Finders that ask a language model, against a real server that behaves well and badly."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.cli.main import main
from model.core.errors import ConfigurationError
from model.scenes.articulable_finders import FinderOptions, LexiconFinder, load_finder
from model.scenes.language_finder import (
    FinderUnavailableError,
    LanguageFinder,
    parse_answer,
    question,
)
from model.scenes.scene import ArticulableFinder, ObjectDescription
from tests.model.prediction.arti4urdf.tiny_qwen3 import write_tiny_qwen3
from tests.model.scenes import scenes_made as made
from tests.model.scenes.chat_server import ChatServer, chat_server, decisions, fault, said

pytest.importorskip("openai", reason="the finder's tests need openai (artiworld[finder])")

OBJECTS = [
    ObjectDescription("a white cabinet", "cabinet", (0.6, 0.5, 0.8)),
    ObjectDescription("a small rock"),
    ObjectDescription("an old fridge"),
    ObjectDescription("a red chair"),
    ObjectDescription("a plush bear"),
]
RIGHT = [True, False, True, False, False]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[ChatServer]:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    with chat_server() as state:
        yield state


def finder_of(server: ChatServer, cache: Path | None = None, **more: object) -> LanguageFinder:
    options = FinderOptions(server.url, cache=cache, **more)  # type: ignore[arg-type]
    finder = load_finder("openai:tiny", options)
    assert isinstance(finder, LanguageFinder)
    return finder


def test_decisions_with_parts_and_reasons(server: ChatServer) -> None:
    finder = finder_of(server)
    assert isinstance(finder, ArticulableFinder)
    found = finder.find([*OBJECTS, OBJECTS[0]])
    assert [d.articulable for d in found] == [*RIGHT, True]
    assert found[0].parts == ("door",) and found[0].reason == "a white cabinet seen"
    assert found[0].kind == "cabinet" and found[0].base == "fixed" and not found[1].parts
    (request,) = server.requests  # the same object is asked once
    assert request["response_format"]["json_schema"]["strict"] is True
    assert json.loads(request["messages"][1]["content"])[0]["size"] == [0.6, 0.5, 0.8]
    assert finder.usage.input_tokens == 100 and finder.usage.price(1.0, 2.0) == 120 / 1e6


def test_objects_go_in_batches_and_answers_are_kept(server: ChatServer, tmp_path: Path) -> None:
    assert [d.articulable for d in finder_of(server, tmp_path, batch=2).find(OBJECTS)] == RIGHT
    assert len(server.requests) == 3
    again = finder_of(server, tmp_path)
    assert [d.articulable for d in again.find(OBJECTS)] == RIGHT
    assert len(server.requests) == 3 and again.usage.cached == 5 and again.usage.requests == 0
    for path in tmp_path.rglob("*.json"):
        path.write_text("torn")
    assert [d.articulable for d in finder_of(server, tmp_path).find(OBJECTS)] == RIGHT
    assert len(server.requests) == 4


@pytest.mark.parametrize("status", [429, 500, 503])
def test_a_busy_server_is_asked_again(server: ChatServer, status: int) -> None:
    server.script = lambda body, objects: (
        fault(status) if len(server.requests) < 3 else said(decisions(objects))
    )
    assert [d.articulable for d in finder_of(server).find(OBJECTS)] == RIGHT
    assert len(server.requests) == 3


def test_a_server_that_stays_busy_is_told_and_nothing_is_lost(
    server: ChatServer, tmp_path: Path
) -> None:
    server.script = lambda body, objects: (
        fault(429, "quota") if len(server.requests) > 1 else said(decisions(objects))
    )
    with pytest.raises(FinderUnavailableError, match=r"quota.*run again"):
        one = load_finder("openai:tiny", FinderOptions(server.url, 4, 9.0, 2, tmp_path))
        assert isinstance(one, LanguageFinder)
        one.engine.parallel = 1
        one.find(OBJECTS)
    server.script = lambda body, objects: said(decisions(objects))
    again = finder_of(server, tmp_path)
    assert [d.articulable for d in again.find(OBJECTS)] == RIGHT and again.usage.cached == 4


def test_a_silent_server_times_out(server: ChatServer) -> None:
    done = threading.Event()

    def wait(body: dict, objects: list) -> tuple:
        done.wait(30)
        return said("")

    server.script = wait
    with pytest.raises(FinderUnavailableError, match="timed out"):
        finder_of(server, timeout=0.2, retries=1).find(OBJECTS)
    done.set()
    assert len(server.requests) == 2


@pytest.mark.parametrize("lacks", ["json_schema", "temperature", "response_format"])
def test_servers_without_structured_output(server: ChatServer, lacks: str) -> None:
    def picky(body: dict, objects: list) -> tuple:
        form = body.get("response_format", {}).get("type")
        if lacks in body or form == lacks or (lacks == "response_format" and form):
            return fault(400, f"unknown option {lacks}")
        return said(f"<think>hm {{</think>Sure:\n```json\n{decisions(objects)}\n```")

    server.script = picky
    finder = finder_of(server, batch=3)
    assert [d.articulable for d in finder.find(OBJECTS)] == RIGHT
    count = len(server.requests)
    finder.find([ObjectDescription("another oven")])
    assert len(server.requests) == count + 1  # what it lacks is remembered


@pytest.mark.parametrize(
    "reply",
    [
        said("I can't help with that"),
        said('{"objects": [{"id": 0, "articulable": "perhaps"}]}'),
        said('{"objects": [{"id": 99, "articulable": true}, {"id": -1, "articulable": true}]}'),
        said("[" * 20_000),
        said("", choices=[]),
        (200, {"content-type": "application/json"}, b"{{{ not json"),
        (200, {"content-type": "text/html"}, b"<html>hello</html>"),
        (200, {"content-type": "application/json"}, b"null"),
    ],
)
def test_garbage_leaves_it_to_the_lexicon(server: ChatServer, reply: tuple) -> None:
    server.script = lambda body, objects: reply
    finder = finder_of(server)
    found = finder.find(OBJECTS)
    assert [d.articulable for d in found] == [d.articulable for d in LexiconFinder().find(OBJECTS)]
    assert all("gave no usable answer" in d.reason for d in found)
    assert finder.usage.by_lexicon == 5 and len(server.requests) == 1 + 1 + 5


def test_what_is_missing_is_asked_again_and_wrong_ids_are_nobodys(server: ChatServer) -> None:
    def forgetful(body: dict, objects: list) -> tuple:
        answer = json.loads(decisions(objects))
        for entry in answer["objects"][1:]:
            entry["id"] += 1000
        return said(json.dumps(answer))

    server.script = forgetful
    finder = finder_of(server)
    assert [d.articulable for d in finder.find(OBJECTS)] == RIGHT
    assert finder.usage.by_lexicon == 0


def test_hostile_text_stays_text() -> None:
    entry = {"id": 0, "articulable": True, "reason": "\u202e\x1b[31m" + "x" * 9999 + "\ud800"}
    entry |= {"parts": ["door\n", 3, "y" * 999] * 50, "kind": "\x00"}
    entry |= {"base": "moon", "confidence": 1e400}
    decision = parse_answer(json.dumps({"objects": [entry, {**entry, "id": True}]}), 2)[0]
    assert len(decision.reason) <= 300 and decision.reason.isprintable()
    assert len(decision.parts) == 24 and decision.kind is None and decision.base is None
    assert 0 <= decision.confidence <= 1


def test_refusals_are_told_in_words(server: ChatServer, monkeypatch: pytest.MonkeyPatch) -> None:
    server.script = lambda body, objects: fault(401, "bad key")
    with pytest.raises(ConfigurationError, match="OPENAI_API_KEY"):
        finder_of(server).find(OBJECTS)
    server.script = lambda body, objects: fault(404, "no model tiny")
    with pytest.raises(ConfigurationError, match="no model tiny"):
        finder_of(server).find(OBJECTS)
    server.script = lambda body, objects: fault(400, "too long")
    with pytest.raises(ConfigurationError, match="too long"):
        finder_of(server).find(OBJECTS)
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    server.script = lambda body, objects: said(decisions(objects))
    finder_of(server).find(OBJECTS)
    assert server.keys[-1] == "Bearer secret" and "secret" not in json.dumps(server.requests)
    with pytest.raises(ConfigurationError, match="no address"):
        load_finder("openai:tiny", FinderOptions("localhost:1"))
    with pytest.raises(ConfigurationError, match="lexicon"):
        load_finder("nonsense")
    monkeypatch.delenv("OPENAI_API_KEY")
    monkeypatch.delenv("OPENAI_BASE_URL", raising=False)
    with pytest.raises(ConfigurationError, match="OPENAI_API_KEY"):
        load_finder("openai:tiny")


def test_from_the_command_line_with_its_cost(
    server: ChatServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = made.write_scene(tmp_path / "layout.json", made.mesatask())
    asked = f"--finder openai:tiny --finder-url {server.url} --finder-cache {tmp_path / 'cache'}"
    words = ["scene", "inspect", str(scene), *asked.split(), "--price", "2,8"]
    assert main([*words, "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["estimate"]
    assert told["requests"] == 1 and told["asked"] == 1 and not server.requests
    assert told["cost"] == pytest.approx(
        (2 * told["input_tokens"] + 8 * told["output_tokens"]) / 1e6
    )
    assert main([*words, "--dry-run"]) == 0 and "1 times" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["objects"][0]["reason"] == "cabinet seen"
    assert report["finder_usage"]["cost"] == pytest.approx((2 * 100 + 8 * 10) / 1e6)
    assert main([*words, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["estimate"]["requests"] == 0


def test_counting_the_questions_needs_no_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
    scene = made.write_scene(tmp_path / "layout.json", made.mesatask())
    places = f"--assets {tmp_path} --out {tmp_path / 'out'} --finder-cache {tmp_path / 'cache'}"
    words = ["scene", "convert", str(scene), "--finder", "openai:tiny", *places.split()]
    assert main([*words, "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["estimate"]["requests"] == 1 and told["finder"] == "openai:tiny"
    assert main(words) == 2 and "OPENAI_API_KEY" in capsys.readouterr().err


def test_a_local_qwen3_always_writes_valid_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from model.prediction.arti4urdf.text_writing import JsonWriter, load_json_writer
    from model.scenes.language_finder import SYSTEM

    choose = JsonWriter.choose

    def other(self: JsonWriter, options: tuple[str, str], feed: bool = True) -> tuple[str, float]:
        return choose(self, (options[1], options[1]), feed)

    said = []
    for seed in range(2):
        folder = write_tiny_qwen3(tmp_path / str(seed), tied=bool(seed % 2), seed=seed)
        writer = load_json_writer(folder)
        first = writer.decide(SYSTEM, question(OBJECTS[:1]))
        writer.decide(SYSTEM, question(OBJECTS[1:2]))
        assert first == writer.decide(SYSTEM, question(OBJECTS[:1]))  # nothing of the last stays
        monkeypatch.setattr(JsonWriter, "choose", other)  # random weights say yes or no only
        said += [first, writer.decide(SYSTEM, question(OBJECTS[:1]))]
        monkeypatch.undo()
    for text in said:
        entry, decision = json.loads(text), parse_answer(text, 1)[0]
        assert decision.articulable is entry["articulable"]
        assert decision.confidence == entry["confidence"] >= 0.5
        assert bool(decision.parts) == decision.articulable
        assert entry["reason"] and entry["kind"] and decision.base in ("fixed", "free")
    assert {parse_answer(text, 1)[0].articulable for text in said} == {True, False}


def test_a_local_qwen3_as_a_finder(tmp_path: Path) -> None:
    folder = write_tiny_qwen3(tmp_path / "qwen")
    finder = load_finder(f"qwen3:{folder}", FinderOptions(cache=tmp_path / "cache"))
    assert isinstance(finder, LanguageFinder)
    found = finder.find(OBJECTS[:2])
    assert finder.usage.by_lexicon == 0 and finder.usage.requests == 2
    assert found == finder.find(OBJECTS[:2]) and finder.usage.cached == 2
    with pytest.raises(ConfigurationError, match="no such folder"):
        load_finder(f"qwen3:{tmp_path / 'nowhere'}").find(OBJECTS[:1])
