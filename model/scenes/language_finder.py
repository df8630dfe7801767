"""A language model decides which objects can be articulated, into which parts, and why (ArtiWorld,
pipeline step 1), whoever runs the model.

Objects are asked in batches, each different one once; answers are kept on disk, so asking again
costs nothing. What a model says is checked entry by entry: what it leaves out, or says of an object
that isn't there, is asked again in smaller batches, and in the end the lexicon decides.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

from model.core.errors import ArtiworldError
from model.core.files import write_json
from model.core.progress import Progress, no_progress
from model.scenes.articulable_finders import LexiconFinder
from model.scenes.scene import ArticulableFinder, Decision, ObjectDescription

SYSTEM = (
    "You know furniture, appliances, tools and how they move. You get rigid objects of a 3D scene "
    "as JSON (sizes are metres: x, y, z). For each, decide whether it can be articulated: whether "
    "the object described has parts that turn or slide against the rest, such as doors, drawers, "
    "lids, knobs, levers, buttons or wheels. A plain table, chair, bowl, plant or picture has "
    'none. Answer with JSON alone: {"objects": [{"id": the object\'s number, "reason": one '
    'short sentence, "articulable": true or false, "parts": kinds of its moving parts, "kind": '
    'what it is in one or two words, "base": "fixed" where it is built in or stands heavily, else '
    '"free"}]}, with one entry for each id.'
)
_ENTRY = {
    "type": "object",
    "additionalProperties": False,
    "required": ["id", "reason", "articulable", "parts", "kind", "base"],
    "properties": {
        "id": {"type": "integer"},
        "reason": {"type": "string"},
        "articulable": {"type": "boolean"},
        "parts": {"type": "array", "items": {"type": "string"}},
        "kind": {"type": "string"},
        "base": {"type": "string", "enum": ["fixed", "free"]},
    },
}
SCHEMA: dict[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "required": ["objects"],
    "properties": {"objects": {"type": "array", "items": _ENTRY}},
}
"""JSON schema of an answer."""

MOST_PARTS, LONGEST_PART, LONGEST_REASON = 24, 40, 300
_BYTES_A_TOKEN = 3.5
"""Bytes a token of JSON and English, by the usual tokenizers; an estimate."""
_LOOKS_UP = 0.25
"""Seconds after which whoever waits for an answer hears an interrupt."""
_TOKENS_AN_ANSWER = 70


class FinderUnavailableError(ArtiworldError):
    """The language model can't be asked now; answers that it gave are kept."""


@dataclass(frozen=True)
class Answer:
    """A model's reply.

    Attributes:
        text: "" without a usable answer.
        input_tokens, output_tokens: as the server counted them; 0 where it doesn't say.
    """

    text: str
    input_tokens: int = 0
    output_tokens: int = 0


class ChatEngine(Protocol):
    """Runs the model.

    Attributes:
        name: of the model and where it runs; answers are kept under it.
        batch: objects a question.
        parallel: questions at a time.
    """

    name: str
    batch: int
    parallel: int

    def ask(self, system: str, user: str) -> Answer:
        """Its answer.

        Raises:
            FinderUnavailableError: where it can't be asked, after having tried again.
            ConfigurationError: where it never will (no such model, key refused).
        """
        ...

    def close(self) -> None:
        """Give back what it holds, a question under way included; it may be asked again."""
        ...


@dataclass(frozen=True)
class Usage:
    """Usage so far, or its estimate.

    Attributes:
        requests: questions.
        input_tokens, output_tokens: counted by the server, or estimated.
        asked: objects in them; ``cached`` were answered before.
        by_lexicon: objects for which the model gave no usable answer.
    """

    requests: int = 0
    input_tokens: int = 0
    output_tokens: int = 0
    asked: int = 0
    cached: int = 0
    by_lexicon: int = 0

    def price(self, input_million: float, output_million: float) -> float:
        """In the currency of the prices, which are for a million tokens."""
        return (self.input_tokens * input_million + self.output_tokens * output_million) / 1e6


@dataclass(eq=False)
class LanguageFinder:
    """See :class:`~model.scenes.scene.ArticulableFinder`.

    Attributes:
        engine: runs the model.
        cache: folder of answers, or None to keep none.
        fallback: decides where the model doesn't.
        progress: reports each answer.
        usage: so far.
    """

    engine: ChatEngine
    cache: Path | None = None
    fallback: ArticulableFinder = field(default_factory=LexiconFinder)
    progress: Progress = no_progress
    usage: Usage = field(default_factory=Usage)

    def __post_init__(self) -> None:
        self.name = self.engine.name
        self._lock = Lock()

    def find(self, objects: Sequence[ObjectDescription]) -> list[Decision]:
        """See :class:`~model.scenes.scene.ArticulableFinder`.

        Raises:
            FinderUnavailableError, ConfigurationError: as the engine's ``ask``.
        """
        unique = list(dict.fromkeys(objects))
        known = {o: d for o in unique if (d := self._kept(o)) is not None}
        self.usage = replace(self.usage, cached=self.usage.cached + len(known))
        try:
            for size in sorted({self.engine.batch, -(-self.engine.batch // 4), 1}, reverse=True):
                left = [o for o in unique if o not in known]
                if left:
                    known |= self._round(left, size, len(unique))
        finally:
            self.engine.close()
        left = [o for o in unique if o not in known]
        self.usage = replace(self.usage, by_lexicon=self.usage.by_lexicon + len(left))
        for obj, decision in zip(left, self.fallback.find(left), strict=True):
            why = f"{self.name} gave no usable answer; {self.fallback.name}: {decision.reason}"
            known[obj] = replace(decision, reason=why, confidence=decision.confidence / 2)
        return [known[o] for o in objects]

    def estimate(self, objects: Sequence[ObjectDescription]) -> Usage:
        """The usage of :meth:`find`, tokens estimated by the length of the text."""
        unique = list(dict.fromkeys(objects))
        left = [o for o in unique if self._kept(o) is None]
        batches = _cut(left, self.engine.batch)
        length = sum(len((SYSTEM + question(b)).encode()) for b in batches)
        return Usage(
            len(batches),
            round(length / _BYTES_A_TOKEN),
            _TOKENS_AN_ANSWER * len(left),
            len(left),
            len(unique) - len(left),
        )

    def _round(
        self, left: list[ObjectDescription], size: int, count: int
    ) -> dict[ObjectDescription, Decision]:
        found: dict[ObjectDescription, Decision] = {}

        def ask(batch: list[ObjectDescription]) -> None:
            answer = self.engine.ask(SYSTEM, question(batch))
            said = parse_answer(answer.text, len(batch))
            with self._lock:
                u = self.usage
                self.usage = replace(
                    u,
                    requests=u.requests + 1,
                    asked=u.asked + len(batch),
                    input_tokens=u.input_tokens + answer.input_tokens,
                    output_tokens=u.output_tokens + answer.output_tokens,
                )
                for i, decision in said.items():
                    found[batch[i]] = decision
                    self._keep(batch[i], decision)
                done = count - len(left) + len(found)
                self.progress(done / count, f"{self.name}: {done}/{count} objects")

        with ThreadPoolExecutor(max_workers=self.engine.parallel) as pool:
            futures = [pool.submit(ask, batch) for batch in _cut(left, size)]
            try:
                _hear(pool, futures)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                # The pool waits for running requests, some of which may only begin now.
                while under_way := [f for f in futures if not f.done()]:
                    self.engine.close()
                    wait(under_way, timeout=_LOOKS_UP)
                raise
        return found

    def _file(self, obj: ObjectDescription) -> Path | None:
        if self.cache is None:
            return None
        content = json.dumps([self.name, SYSTEM, asdict(obj)], sort_keys=True)
        digest = hashlib.sha256(content.encode()).hexdigest()
        return self.cache / digest[:2] / f"{digest}.json"

    def _kept(self, obj: ObjectDescription) -> Decision | None:
        path = self._file(obj)
        try:
            entry = None if path is None else json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return None if entry is None else decision_of(entry)

    def _keep(self, obj: ObjectDescription, decision: Decision) -> None:
        path = self._file(obj)
        if path is not None:
            write_json(path, asdict(decision), indent=1)


def question(objects: Sequence[ObjectDescription]) -> str:
    """The user's turn: the objects by number."""
    content = []
    for i, o in enumerate(objects):
        entry: dict[str, Any] = {"id": i, "description": o.description}
        if o.category:
            entry["category"] = o.category
        if o.size is not None:
            entry["size"] = [round(float(v), 3) for v in o.size]
        content.append(entry)
    return json.dumps(content, ensure_ascii=False)


def parse_answer(text: str, count: int) -> dict[int, Decision]:
    """Decisions by number, parsed from a model's answer; other content is skipped.

    Args:
        text: JSON, which may stand in a code fence or behind thoughts.
        count: numbers from this one on belong to nobody.
    """
    tree = _json_in(re.sub(r"(?s)^.*</think>", "", text))
    entries = tree.get("objects") if isinstance(tree, dict) else tree
    if isinstance(tree, dict) and "articulable" in tree:
        entries = [tree]
    out: dict[int, Decision] = {}
    for entry in entries if isinstance(entries, list) else ():
        if not isinstance(entry, dict):
            continue
        number = entry.get("id", 0 if count == 1 else None)
        if isinstance(number, str) and number.isascii() and number.isdigit():
            number = int(number[:9])
        decision = decision_of(entry)
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < count:
            continue
        if decision is not None:
            out.setdefault(number, decision)
    return out


def decision_of(entry: Any) -> Decision | None:
    """A decision from JSON values, or None if they are invalid."""
    if not isinstance(entry, dict) or not isinstance(entry.get("articulable"), bool):
        return None
    parts = entry.get("parts")
    texts = [p for p in parts if isinstance(p, str)] if isinstance(parts, list) else []
    kind, base, sure = entry.get("kind"), entry.get("base"), entry.get("confidence", 0.9)
    known = isinstance(sure, int | float) and not isinstance(sure, bool) and 0 <= sure <= 1
    return Decision(
        entry["articulable"],
        tuple(_line(p, LONGEST_PART) for p in texts[:MOST_PARTS]) if entry["articulable"] else (),
        _line(entry.get("reason"), LONGEST_REASON) or "no reason was given",
        _line(kind, LONGEST_PART).lower() or None,
        base if base in ("fixed", "free") else None,
        float(sure) if known else 0.9,
    )


def _json_in(text: str) -> Any:
    """The first JSON object or list in a text, or None."""
    decoder = json.JSONDecoder()
    for match in list(re.finditer(r"[\[{]", text))[:20]:
        try:
            return decoder.raw_decode(text, match.start())[0]
        except ValueError:
            continue
        except RecursionError:
            return None
    return None


def _line(value: Any, longest: int) -> str:
    """Printable text on one line, cut to its longest."""
    if not isinstance(value, str):
        return ""
    # Half a surrogate pair is valid in JSON and can't be written.
    plain = value.encode("utf-8", "ignore").decode()
    return " ".join("".join(c if c.isprintable() else " " for c in plain).split())[:longest]


def _hear(pool: Executor, futures: Sequence[Future[None]]) -> None:
    """Wait for all; after a failure nothing new is asked, and what is under way is still kept."""
    try:
        for future in futures:
            _wait_for([future])
            future.result()
    except Exception:
        pool.shutdown(wait=False, cancel_futures=True)
        _wait_for(futures)
        raise


def _wait_for(futures: Sequence[Future[None]]) -> None:
    # Another thread may be the one that an interrupt wakes: look up now and then.
    while left := [f for f in futures if not f.done()]:
        wait(left, timeout=_LOOKS_UP)


def _cut(objects: list[ObjectDescription], size: int) -> list[list[ObjectDescription]]:
    return [objects[i : i + size] for i in range(0, len(objects), size)]
