"""The command line: ``artiworld serve | segment | predict | export | …``.

Exit codes: 0; 2 for the user's mistake, with one line on stderr that says what to do; 1 for our own
fault, with its details in a log file. Nothing heavy is imported before a command needs it.
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from model.errors import ArtiworldError
from model.predictors import DEFAULT as DEFAULT_PREDICTOR

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
_DESCRIPTION = "Turn rigid scans and meshes into articulated, simulator-ready assets."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    words = _joined_axes(list(sys.argv[1:] if arguments is None else arguments))
    try:
        args = make_parser().parse_args(words)
    except SystemExit as done:  # --help, --version, or a mistake that was told already
        return int(done.code or 0)
    debug = args.debug
    _set_up_logging(args.log_level, debug)
    try:
        return args.run(args) or 0
    except ArtiworldError as error:
        if debug:
            traceback.print_exc()
        _tell(error)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of our output has gone, as in "| head"
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 128 + signal.SIGPIPE
    except Exception as error:  # the boundary of the program
        return _our_fault(error, debug)


def _set_up_logging(level: int, debug: bool) -> None:
    """Our own messages from ``level`` on; libraries' only where they are grave."""
    logging.basicConfig(
        level=logging.DEBUG if debug else max(level, logging.WARNING),
        format="%(levelname)s %(name)s: %(message)s",
    )
    if debug:
        return
    warnings.simplefilter("ignore")
    for package in ("app", "model", "sessions"):
        logging.getLogger(package).setLevel(level)


def make_parser() -> argparse.ArgumentParser:
    """All commands and options."""
    parser = _Parser(prog="artiworld", description=_DESCRIPTION)
    parser.add_argument("--version", action=_Version)
    parser.add_argument("--debug", action="store_true", help="show tracebacks and debug messages")
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True, parser_class=_Parser
    )
    for name, add, run, text in (
        ("serve", _add_serve, _serve, "open scans in the browser and articulate them"),
        ("segment", _add_segment, _segment, "cut a scan into parts by clicks from a file"),
        ("predict", _add_predict, _predict, "predict the joints of a folder of parts"),
        ("scene", _add_scene, _scene, "articulate a whole scene, its objects in place"),
        ("backend", _add_backend, _backend, "predict for other machines over HTTP"),
        ("export", _add_export, _export, "write articulated objects for simulators"),
        ("check", _add_check, _check, "say whether articulated objects work in simulators"),
        ("evaluate", _add_evaluate, _evaluate, "score a predictor on a data set"),
        ("generate", _add_generate, _generate, "make articulated objects with ground truth"),
        ("train", _add_train, _train, "train Arti4URDF on objects made here or your own"),
        ("bench", _add_bench, _bench, "measure speed and accuracy"),
        ("doctor", _add_doctor, _doctor, "say what is installed, usable and wrong"),
    ):
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        add(command)
        # Also after the command; SUPPRESS keeps its default from undoing the one before it.
        command.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS
        )
        level = logging.INFO if name == "serve" else logging.ERROR
        command.set_defaults(run=run, log_level=level)
    return parser


class _Parser(argparse.ArgumentParser):
    """argparse with one line for a mistake instead of the whole usage."""

    def __init__(self, **settings: object) -> None:
        super().__init__(allow_abbrev=False, **settings)  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


class _Version(argparse.Action):
    def __init__(self, option_strings: list[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"artiworld {version('artiworld')}")
        parser.exit()


def _joined_axes(words: list[str]) -> list[str]:
    """argparse would take the -z of ``--up-axis -z`` for an option."""
    out: list[str] = []
    for word in words:
        if out and out[-1] == "--up-axis" and word in UP_AXES:
            out[-1] = f"--up-axis={word}"
        else:
            out.append(word)
    return out


def _tell(error: BaseException) -> None:
    print(f"artiworld: {' '.join(str(error).split())}", file=sys.stderr)


def _our_fault(error: Exception, debug: bool) -> int:
    if debug:
        traceback.print_exception(error)
        return 1
    from app.crash_log import write_crash

    where = write_crash(error)
    kind = "" if type(error) is RuntimeError else f"{type(error).__name__}: "
    message = " ".join(str(error).split())[:300]
    print(f"artiworld: {kind}{message} (details: {where})", file=sys.stderr)
    return 1


# Options


def _add_reading(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--up-axis", choices=UP_AXES, metavar="AXIS",
        help=f"up axis of the files, one of {', '.join(UP_AXES)} (default: by format)",
    )  # fmt: skip
    parser.add_argument(
        "--unit-scale", type=_positive_number, default=1.0, metavar="METRES",
        help="metres per unit of the files, 0.001 for millimetres (default: 1)",
    )  # fmt: skip


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")


def _positive_number(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError
    return value


_count.__name__ = "whole number"
_positive_number.__name__ = "positive number"


def _add_serve(parser: argparse.ArgumentParser) -> None:
    from app.backend_command import add_client_options

    add = parser.add_argument
    add("paths", nargs="*", type=Path, metavar="PATH",
        help="files or folders to open, or one scene (default: the bundled examples)")  # fmt: skip
    add("--assets", type=Path, action="append", default=[], metavar="DIR",
        help="open PATH as a scene with the assets in this folder; may be repeated "
             "(a scene description without it: those beside it)")  # fmt: skip
    add("--scene", action="store_true",
        help="open PATH as a scene even where it is a mesh or a scan, such as a scanned room "
             "out of which objects are picked")  # fmt: skip
    add("--finder", default="lexicon", metavar="NAME",
        help="who says what in a scene can be articulated, as scene convert takes it "
             "(default: lexicon)")  # fmt: skip
    add("--finder-url", metavar="URL",
        help="openai finder: address of the server, such as http://localhost:11434/v1")  # fmt: skip
    add("--workspace", type=Path, default=Path("workspace"), metavar="DIR",
        help="where sessions and accepted assets are kept (default: ./workspace)")  # fmt: skip
    add("--database", metavar="URL", help="SQLAlchemy URL (default: SQLite in the workspace)")
    add(
        "--host", default="127.0.0.1", help="where to listen; others than this machine need a token"
    )
    add(
        "--port", type=int, help="port to listen at; 0 for any (default: 8080 or the next free one)"
    )
    add("--token", help="what visitors must know; or set ARTIWORLD_TOKEN")
    add("--allow-origin", action="append", default=[], metavar="URL",
        help="address under which a proxy shows the server; may be repeated")  # fmt: skip
    add("--user", help="name written beside decisions (default: your login name)")
    _add_reading(parser)
    add("--max-upload-mb", type=int, default=500, metavar="MB",
        help="largest file that a browser may send (default: 500)")  # fmt: skip
    add("--segmenter", default="default", metavar="NAME", help="who answers clicks")
    _add_point_sam(parser)
    add("--predictor", default=DEFAULT_PREDICTOR, metavar="NAME", help="who predicts joints")
    add_client_options(parser, "--backend-token")
    add("--open", action=argparse.BooleanOptionalAction, default=False, help="open a browser")


def _add_point_sam(parser: argparse.ArgumentParser) -> None:
    """``--point-sam PATH`` is ``--segmenter point-sam:PATH``."""
    parser.add_argument(
        "--point-sam", dest="segmenter", type="point-sam:{}".format, metavar="PATH",
        help="let Point-SAM answer, with the published weights at PATH")  # fmt: skip


def _add_segment(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("scan", type=Path, metavar="SCAN", help="a mesh, a point cloud or a folder of parts")
    add("--prompts", type=Path, required=True, metavar="FILE", help="JSON file of clicks")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the parts")
    add("--segmenter", default="default", metavar="NAME", help="who answers the clicks")
    _add_point_sam(parser)
    _add_reading(parser)
    _add_json(parser)


def _add_predict(parser: argparse.ArgumentParser) -> None:
    from app.backend_command import add_client_options

    add = parser.add_argument
    add("folder", type=Path, metavar="DIR", help="folder with link_0, link_1, … or an object.json")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the URDF and its meshes")
    add("--predictor", default=DEFAULT_PREDICTOR, metavar="NAME", help="who predicts")
    add_client_options(parser, "--token")
    add("--category", metavar="NAME", help="what the object is, such as cabinet")
    add("--seed", type=int, default=0, help="the only source of randomness (default: 0)")
    _add_reading(parser)
    _add_json(parser)


def _add_scene(parser: argparse.ArgumentParser) -> None:
    from app.scene_command import add_options

    add_options(parser)


def _add_backend(parser: argparse.ArgumentParser) -> None:
    from app.backend_command import add_options

    add_options(parser)


def _add_export(parser: argparse.ArgumentParser) -> None:
    from app.export_command import add_options

    add_options(parser)


def _add_check(parser: argparse.ArgumentParser) -> None:
    from app.check_command import add_options

    add_options(parser)


def _add_evaluate(parser: argparse.ArgumentParser) -> None:
    from app.evaluate_command import add_options

    add_options(parser)
    _add_json(parser)


def _add_generate(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--family", nargs="+", default=["all"], metavar="NAME",
        help="categories of PartNet-Mobility, Composite, or all")  # fmt: skip
    add("--n", type=_count, default=1, metavar="N", help="objects of each family (default: 1)")
    add("--seed", type=int, default=0, help="the same seed gives the same objects")
    add("--out", type=Path, required=True, metavar="DIR", help="gets one folder an object")
    _add_json(parser)


def _add_train(parser: argparse.ArgumentParser) -> None:
    from app.train_command import add_train

    add_train(parser)


def _add_bench(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("what", choices=("ui", "scene", "segment", "predict"))
    add("--data", type=Path, metavar="DIR", help="segment: folder of real data, by default made up")
    add("--sets", nargs="+", metavar="NAME", help="segment: which data sets")
    add("--segmenter", action="append", metavar="NAME",
        help="segment: may be repeated; ui: who answers the clicks")  # fmt: skip
    add("--points", type=_count, nargs="+", metavar="N", help="ui: sizes of the clouds")
    add("--faces", type=_count, metavar="N", help="ui: size of the mesh; 0 leaves it out")
    add("--clicks", type=_count, metavar="N", help="ui: clicks on each object")
    add("--objects", type=_count, metavar="N", help="scene: how many (default: 200)")
    add("--limit", type=int, help="segment: objects of each set")
    add("--offset", type=int, metavar="N", help="segment: with which object the subset begins")
    add("--parts", type=_count, metavar="N", help="segment: parts asked for in an object at most")
    add("--first", choices=("deepest", "random"), help="segment: where the first click goes")
    _add_json(parser)


def _add_doctor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--workspace", type=Path, default=Path("workspace"), metavar="DIR")
    parser.add_argument("--database", metavar="URL")
    parser.add_argument("--port", type=int, default=8080)
    _add_json(parser)


# Commands


def _serve(args: argparse.Namespace) -> int:
    from app.serve_command import run_serve

    return run_serve(args)


def _segment(args: argparse.Namespace) -> int:
    from app import headless, printing

    with printing.session(args.json) as show:
        report = headless.segment(
            args.scan, args.prompts, args.out, segmenter=args.segmenter,
            reading=headless.ReadOptions(args.up_axis, args.unit_scale), progress=show.progress,
        )  # fmt: skip
    show.result(report, lambda: printing.parts_table(report, args.out))
    return 0


def _predict(args: argparse.Namespace) -> int:
    from app import headless, printing
    from app.backend_command import chosen_predictor

    with printing.session(args.json) as show:
        report = headless.predict(
            args.folder, args.out, predictor=chosen_predictor(args), category=args.category,
            seed=args.seed, reading=headless.ReadOptions(args.up_axis, args.unit_scale),
            progress=show.progress,
        )  # fmt: skip
    show.result(report, lambda: printing.joints_table(report, args.out))
    return 0


def _scene(args: argparse.Namespace) -> int:
    from app.scene_command import run_scene

    return run_scene(args)


def _backend(args: argparse.Namespace) -> int:
    from app.backend_command import run_backend

    return run_backend(args)


def _export(args: argparse.Namespace) -> int:
    from app.export_command import run_export

    return run_export(args)


def _check(args: argparse.Namespace) -> int:
    from app.check_command import run_check

    return run_check(args)


def _generate(args: argparse.Namespace) -> int:
    from app import printing
    from model.datasets.procedural.generate import GenerateSettings, generate

    settings = GenerateSettings(args.out, tuple(args.family), args.n, args.seed)
    with printing.session(args.json) as show:
        folders = generate(settings, show.progress)
    show.result(
        {"folders": [str(f) for f in folders]},
        lambda: print(f"{len(folders)} objects in {args.out}"),
    )
    return 0


def _evaluate(args: argparse.Namespace) -> int:
    from app.evaluate_command import run_evaluate

    return run_evaluate(args)


def _train(args: argparse.Namespace) -> int:
    from app.train_command import run_train

    return run_train(args)


def _bench(args: argparse.Namespace) -> int:
    from app import bench, printing

    runs: dict[str, Callable[[], bench.Bench]] = {
        "ui": lambda: bench.bench_ui(
            args.points, args.faces, args.clicks, (args.segmenter or [None])[0]
        ),
        "scene": lambda: bench.bench_scene(args.objects),
        "segment": lambda: bench.bench_segment(
            args.data,
            args.sets,
            args.segmenter,
            show.progress,
            limit=args.limit,
            offset=args.offset,
            parts=args.parts,
            first=args.first,
        ),
        "predict": lambda: bench.bench_predict(show.progress),
    }
    with printing.session(args.json) as show:
        answer = runs[args.what]()
    show.result(answer.report, answer.show)
    return 0


def _doctor(args: argparse.Namespace) -> int:
    from app import doctor, printing

    with printing.session(args.json) as show:
        checks = doctor.examine(args.workspace, args.database, args.port)
    show.result(doctor.to_json(checks), lambda: printing.checks_table(checks))
    return 1 if any(check.status == "wrong" for check in checks) else 0


if __name__ == "__main__":
    sys.exit(main())
