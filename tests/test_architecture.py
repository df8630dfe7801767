"""The shape of the code: layers, no circles, few hidden imports, no private words."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import networkx as nx
import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("app", "sessions", "model")

LAYERS = (
    ("app", "sessions", "model"),
    ("app.cli", "app.viewer", "app.server"),
    (
        *"model.scenes model.training model.evaluation model.data model.validation".split(),
        *"model.prediction model.segmentation model.io model.physics".split(),
        *"model.kinematics model.geometry model.core".split(),
    ),
)
"""Each imports only those after it in its row, whatever kind of import it is."""

HEAVY = {
    "torch": (
        *"model.prediction.arti4urdf model.training model.segmentation.adapters".split(),
        *"model.core.files app.cli".split(),
    ),
    "viser": ("app.viewer", "app.server", "app.cli"),
    "sqlalchemy": ("sessions", "app.cli"),
}
"""Third-party package → where alone it may be imported."""

MOST_HIDDEN = 30
"""Imports of ours inside functions outside the command line; a comment gives each a reason."""

PRIVATE_WORDS = """told crumb crumbs speck specks stray strays relief spoken mend mends mended
    mending wish wishes workbench desk watched closeup fittings plates retype retyping retyped tints
    unsure judging judged gate looking beliefs stalled"""
"""Words that may not be part of an identifier; the glossary has the field's word for each."""

WORD_EXCEPTIONS: set[str] = {*"gate gate_proj WORD_EXCEPTIONS PRIVATE_WORDS".split()}
"""Identifiers that hold one of these words in its plain meaning."""


TAKE_NAMES = ("setattr", "getattr", "delattr", "patch", "object")
"""Functions that take the name of a member; the last one is of ``mock.patch``."""


@cache
def sources() -> dict[str, Path]:
    """Module → its file."""
    out: dict[str, Path] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            out[name.removesuffix(".__init__")] = path
    return out


@cache
def imports() -> dict[str, list[tuple[str, ast.stmt, bool]]]:
    """Module → (imported module, statement, whether it stands inside a function)."""
    return {
        module: [
            (name, node, inside)
            for node, inside in _import_statements(ast.parse(path.read_text()))
            for name in _imported(node)
        ]
        for module, path in sources().items()
    }


def _import_statements(
    node: ast.AST, inside: bool = False
) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, inside
        elif not isinstance(child, ast.expr):
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            yield from _import_statements(child, inside or function)


def _imported(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (a.name for a in node.names)
    elif node.module:
        yield from (
            full if (full := f"{node.module}.{a.name}") in sources() else node.module
            for a in node.names
        )


def _within(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def test_no_circle_among_files() -> None:
    graph = nx.DiGraph(
        (module, name)
        for module, found in imports().items()
        for name, _, _ in found
        if name in sources()
    )
    knots = [c for c in nx.strongly_connected_components(graph) if len(c) > 1]
    circles = [nx.find_cycle(graph.subgraph(knot)) for knot in knots]
    shown = ["\n  imports ".join([c[0][0], *(b for _, b in c)]) for c in circles]
    assert not circles, "circles of imports:\n" + "\n".join(shown)


@pytest.mark.parametrize("row", LAYERS, ids=lambda row: row[0].split(".")[0])
def test_layers_import_downwards_only(row: tuple[str, ...]) -> None:
    wrong = [
        f"{module} imports {name}"
        for i, layer in enumerate(row)
        for module, found in imports().items()
        if _within(module, layer)
        for name, _, _ in found
        if any(_within(name, above) for above in row[:i])
    ]
    assert not wrong, "\n".join(wrong)


def test_heavy_packages_stay_in_their_places() -> None:
    wrong = [
        f"{module} imports {name}"
        for module, found in imports().items()
        for name, _, _ in found
        for package, places in HEAVY.items()
        if _within(name, package) and not any(_within(module, place) for place in places)
    ]
    assert not wrong, "\n".join(wrong)


def test_few_imports_of_ours_hide_in_functions() -> None:
    hidden: dict[tuple[str, int], bool] = {}
    for module, found in imports().items():
        if _within(module, "app.cli"):
            continue
        lines = sources()[module].read_text().splitlines()
        for name, node, inside in found:
            if inside and name.split(".")[0] in PACKAGES:
                assert node.end_lineno is not None
                around = lines[node.lineno - 2 : node.end_lineno]
                hidden[module, node.lineno] = any("#" in line for line in around)
    unexplained = [f"{m}:{n}" for (m, n), explained in hidden.items() if not explained]
    assert not unexplained, "no comment says why these are lazy: " + ", ".join(unexplained)
    assert len(hidden) <= MOST_HIDDEN, f"{len(hidden)}: {', '.join(f'{m}:{n}' for m, n in hidden)}"


def test_tests_use_what_is_public() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for line, name in _private_uses(ast.parse(path.read_text()))
    ]
    assert not found, "tests see what users see, not private members:\n" + "\n".join(found)


def test_browser_tests_wait_for_states() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in (ROOT / "tests/browser").glob("test_*.py")
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if "wait_for_timeout" in line and "#" not in line
    ]
    assert not found, "no comment says why these wait for a time: " + ", ".join(found)


def _private_uses(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Private members of others, and of our modules, that a file reads, imports or replaces."""
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Attribute):
            of = node.value.id if isinstance(node.value, ast.Name) else ""
            names = [] if of in ("self", "cls") else [f"{of}.{node.attr}"]
        elif isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in PACKAGES:
            names = [f"{node.module}.{a.name}" for a in node.names]
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in TAKE_NAMES:
                names = [str(a.value) for a in node.args if isinstance(a, ast.Constant)]
        for name in names:
            if re.match("_(?!_)", name.split(".")[-1]) and name != "os._exit":  # it is documented
                yield node.lineno, name


def test_private_words_do_not_come_back() -> None:
    found: set[str] = set()
    for module, path in sources().items():
        text = path.read_text()
        private = {word for word in set(re.findall(r"[^\W\d]\w*", text)) if _is_private(word)}
        if private:  # in a comment, most likely; taking a file to pieces is slow
            tokens = tokenize.generate_tokens(io.StringIO(text).readline)
            names = {token.string for token in tokens if token.type == tokenize.NAME}
            found |= {f"{module}: {name}" for name in private & names}
    assert not found, "the glossary has other words for:\n" + "\n".join(sorted(found))


def _is_private(identifier: str) -> bool:
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", identifier).lower()
    private = set(PRIVATE_WORDS.split()) & set(spaced.split("_"))
    return bool(private) and identifier not in WORD_EXCEPTIONS
