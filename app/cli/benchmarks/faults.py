"""``artiworld bench faults``: damaged files of every format, each read in a process with limits;
six people who click while a seventh opens the worst files; servers that are killed at random
moments.
"""

from __future__ import annotations

import itertools
import json
import os
import random
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from base64 import b64encode
from collections import Counter
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from app.cli.bench_commands import FaultsBench
from app.cli.benchmarks.shapes import FaultSample, damaged, fault_samples
from app.cli.benchmarks.ui import (
    MOST_PROMPTS,
    PAUSE,
    SimulatedBrowser,
    cabinet_cloud,
    drawer_ray,
    wait_for,
    waiting_times,
)
from app.cli.output import Result, console, print_records
from app.cli.serve import start_server
from app.client import ApiError, Client
from app.server.accepting import accept
from app.server.api.project import WebhookSender
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.ending import unfinished
from app.server.job import JobFailed, OutOfTimeError, WorkerDied
from app.server.jobs import WorkerProcess
from app.server.uploads import keep_upload
from model.core.errors import ArtiworldError
from model.core.memory import limit_process
from model.core.progress import Progress
from model.io.assets.reader import load_object
from model.io.model_files import find_assets
from model.io.open_asset import open_asset
from model.io.write import write_cloud
from model.scenes.registry import read_scene
from model.scenes.unpacking import unpack
from sessions.commands import NamePart, Reject
from sessions.live import LiveSession
from sessions.release_files import check_release, write_release
from sessions.releases import Release, accepted_assets
from sessions.store import Store

PEOPLE, POINTS = 6, 50_000
"""Six scans of so many points stay encoded together."""
QUIET = 0.25
"""Time without worst files, as a share of the time with them."""
LOST, LOOK = 30.0, 20.0
"""Seconds after which a click is lost, and after which a person leaves what doesn't open."""
_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
TRIANGLE = f"data:application/octet-stream;base64,{b64encode(_CORNERS.tobytes()).decode()}"


def click_beside(seconds: int, seed: int, progress: Progress) -> list[dict[str, Any]]:
    """Measure clicks, and waits for small files, without and with somebody who opens the worst.

    Returns:
        One row each: clicks, those lost, times in ms of the others, their 95th percentile by the
        one without, the number of worst files that opened, were refused, or were left, and the
        95th percentile of the seconds until a small file of another person is read.
    """
    with tempfile.TemporaryDirectory(prefix="artiworld-clients-") as folder:
        root = Path(folder)
        rng = np.random.default_rng(seed)
        scans = tuple(root / f"scan {i}.ply" for i in range(PEOPLE))
        for path in scans:
            write_cloud(cabinet_cloud(POINTS, rng), path)
        worst = write_worst(root)
        server: Any = start_server(ServeConfig(paths=scans, workspace=root / "workspace", port=0))
        try:
            ids = [record.id for record in server.app_state.queue.records()]
            tabs = [_tab(server, id) for id in (*ids, ids[0])]
            progress(0.1, "alone")
            small = partial(_open_small, server, root)
            rows = [_phase(tabs[:-1], seconds * QUIET, seed, small, None)]
            attack = partial(_open, server, tabs[-1][1], worst)
            progress(QUIET, "beside the worst files")
            rows.append(_phase(tabs[:-1], seconds, seed + 1, small, attack))
        finally:
            server.close()
    return [{**row, "p95 ratio": round(row["p95 ms"] / rows[0]["p95 ms"], 2)} for row in rows]


def _tab(server: Any, id: int) -> tuple[SimulatedBrowser, Any]:
    """A browser and what the server shows it: an object that is ready for clicks."""
    known = set(server.apps)
    browser = SimulatedBrowser(server.url)
    wait_for(lambda: set(server.apps) - known, "the tab")
    app = server.apps[next(iter(set(server.apps) - known))]
    shown = app.tab.selection
    wait_for(lambda: shown.object is not None, "its first object")
    app.tab.act(lambda: app._navigation.open(id))
    wait_for(lambda: shown.object.record.id == id and shown.object.asset is not None, "its own")
    timed_click(browser, app, np.random.default_rng(id))  # is answered once it is encoded
    app.tab.act(app.commands.undo)
    # A click before that would seem lost, as prompts become fewer.
    wait_for(lambda: not shown.object.document.prompts, "the undone click")
    wait_for(lambda: not shown.object.busy, "the segmenter")
    return browser, app


def _phase(
    tabs: list[tuple[Any, Any]], seconds: float, seed: int, small: Any, attack: Any
) -> dict[str, Any]:
    """Let everybody click for so long, beside ``small`` and ``attack``, which get the end; one
    row."""
    end, taken, waits = time.perf_counter() + seconds, list[float](), list[float]()
    threads = [
        threading.Thread(target=_work, args=(*tab, end, np.random.default_rng((seed, i)), taken))
        for i, tab in enumerate(tabs)
    ]
    threads.append(threading.Thread(target=small, args=(end, waits)))
    for thread in threads:
        thread.start()
    files = Counter[str]() if attack is None else attack(end)
    for thread in threads:
        thread.join()
    lost = sum(t >= LOST for t in taken)
    return {
        "with": "the worst files" if attack else "nobody else",
        "clicks": len(taken),
        "lost": lost,
        **waiting_times([t for t in taken if t < LOST] or [LOST]),
        **{what: files[what] for what in ("opened", "refused", "left")},
        "small file p95 s": round(float(np.percentile(waits, 95)), 1),
    }


def _open_small(server: Any, folder: Path, end: float, waits: list[float]) -> None:
    """Open new small files as somebody else, one a second; seconds until each is read."""
    while time.perf_counter() < end:
        path = folder / f"small {secrets.token_hex(4)}.obj"
        path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        record = server.app_state.store.open_object(path, None, path.stem)
        obj, began = server.app_state.object(record.id), time.perf_counter()
        while obj.asset is None and not obj.problem and time.perf_counter() < began + LOST:
            time.sleep(0.02)
        waits.append(time.perf_counter() - began)
        time.sleep(1.0)


def _work(
    browser: SimulatedBrowser, app: Any, end: float, rng: np.random.Generator, taken: list[float]
) -> None:
    obj = app.tab.selection.object
    while time.perf_counter() < end:
        taken.append(timed_click(browser, app, rng))
        if len(obj.document.prompts) >= MOST_PROMPTS:
            for _ in obj.document.prompts:
                app.tab.act(app.commands.undo)
            wait_for(lambda: not obj.document.prompts, "the undone clicks")
        time.sleep(rng.uniform(*PAUSE))


def timed_click(browser: SimulatedBrowser, app: Any, rng: np.random.Generator) -> float:
    """Seconds from a click until the browser has its labels, or :data:`LOST`."""
    obj, drawer = app.tab.selection.object, int(rng.integers(3))
    app.tab.selection.part = 1 + drawer
    ray, count = drawer_ray(obj.asset.bounds[0], drawer, rng), len(obj.document.prompts)
    start = time.perf_counter()
    app.tab.act(lambda: app.pointing.click(*ray, True))
    while not (
        len(obj.document.prompts) > count
        and obj.document.segmentation_current
        and app.drawing.shows_labels
    ):
        if time.perf_counter() - start > LOST:
            return LOST
        time.sleep(0.002)
    sent = time.perf_counter()
    while browser.last < sent and time.perf_counter() < sent + 0.1:
        time.sleep(0.002)
    return max(browser.last, sent) - start


def _open(server: Any, app: Any, worst: list[Path], end: float) -> Counter[str]:
    """Open the worst files one after the other, each at least once, as new; count results."""
    files: Counter[str] = Counter()
    for number, path in enumerate(itertools.cycle(worst)):
        if number >= len(worst) and time.perf_counter() > end:
            break
        again = path.with_name(f"{number}-{path.name}")
        os.link(path, again)
        record = server.app_state.store.open_object(again, None, again.stem)
        app.tab.act(lambda id=record.id: app._navigation.open(id))
        obj, began = server.app_state.object(record.id), time.perf_counter()
        while obj.asset is None and not obj.problem and time.perf_counter() < began + LOOK:
            time.sleep(0.05)
        if obj.asset is not None:
            _look_at(app, obj, began + LOOK)
        files["opened" if obj.asset is not None else "refused" if obj.problem else "left"] += 1
    return files


def _look_at(app: Any, obj: Any, until: float) -> None:
    """Click on an object from three sides, and look at it until that is answered."""
    middle, size = obj.asset.bounds.mean(0), obj.asset.diagonal
    for part, away in enumerate(np.array([[0.1, 0.1, 1], [0.1, -1, 0.1], [1, 0.1, 0.1]]), 1):
        app.tab.selection.part = part
        ray = tuple(middle + size * away), tuple(-away)
        app.tab.act(lambda ray=ray: app.pointing.click(*ray, True))
    time.sleep(1.0)  # until the clicks have begun
    while (obj.busy or not obj.document.segmentation_current) and time.perf_counter() < until:
        time.sleep(0.05)


def write_worst(folder: Path) -> list[Path]:
    """Write files that cost much: their reading was quadratic, exponential, or took gigabytes."""
    out = [
        folder / f"{n}" for n in ("face.obj", "shared.gltf", "nodes.gltf", "line.csv", "map.obj")
    ]
    turn = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    radius = np.where(np.arange(len(turn)) % 2, 1.0, 0.5)
    star = np.column_stack((radius * np.cos(turn), radius * np.sin(turn), 0 * turn))
    corners = " ".join(map(str, range(1, len(turn) + 1)))
    out[0].write_text("".join(f"v {x} {y} {z}\n" for x, y, z in star) + f"f {corners}\n")
    chain = [{"children": [i + 1, i + 1]} for i in range(40)] + [{"mesh": 0}]
    for path, nodes in ((out[1], chain), (out[2], [{"mesh": 0}] * 200_000)):
        scene = {"nodes": [0] if nodes is chain else list(range(len(nodes)))}
        path.write_text(json.dumps({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [scene], "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                           "min": [0, 0, 0], "max": [1, 1, 0]}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": TRIANGLE}],
        }))  # fmt: skip
    out[3].write_text("1.5,2.5,3.5," * 10_000_000)
    out[4].write_text(
        "mtllib map.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    )
    (folder / "map.mtl").write_text("newmtl a\nmap_Kd map.png\n")
    Image.new("L", (13_000, 13_000)).save(folder / "map.png")
    return out


STRANGERS = 255
"""Connections of visitors without an account."""
_LOGIN = b"POST /api/v1/login HTTP/1.1\r\nHost: x\r\nX-ArtiWorld: 1\r\nContent-Length: 90\r\n\r\n"


def ask_beside(seconds: int) -> list[dict[str, Any]]:
    """Measure a person's requests without and beside strangers who send bodies a byte a second.

    Returns:
        One row each: requests, those refused, and the 95th percentile of their times in ms.
    """
    with tempfile.TemporaryDirectory(prefix="artiworld-strangers-") as folder:
        workspace = Path(folder)
        with closing(Store(workspace)) as store:
            ann = store.people.accounts.add("ann", "annotator", secrets.token_hex())
            token = store.people.credentials.make_token(ann, "bench", ("read",))
        server: Any = start_server(ServeConfig(workspace=workspace, port=0))
        over = threading.Event()
        try:
            client = Client(server.url, token)
            rows = [{"with": "nobody else", **_asked(client, seconds * QUIET)}]
            strangers = threading.Thread(target=_drip, args=(server.viser.get_port(), over))
            strangers.start()
            rows.append({"with": f"{STRANGERS} strangers", **_asked(client, seconds)})
            over.set()
            strangers.join()
        finally:
            over.set()
            server.close()
    return rows


def _drip(port: int, over: threading.Event) -> None:
    """Send many logins, each a byte a second; who is cut off begins anew."""
    sockets: list[socket.socket] = []
    while not over.wait(1.0):
        for one in list(sockets):
            try:
                one.send(b"{")
            except OSError:
                sockets.remove(one)
        with suppress(OSError):
            while len(sockets) < STRANGERS:
                sockets.append(socket.create_connection(("127.0.0.1", port), 1))
                sockets[-1].sendall(_LOGIN)
    for one in sockets:
        one.close()


def _asked(client: Client, seconds: float) -> dict[str, Any]:
    taken, refused, end = list[float](), 0, time.perf_counter() + seconds
    while (began := time.perf_counter()) < end:
        try:
            list(client.objects())
        except (ApiError, OSError):
            refused += 1
        taken.append(time.perf_counter() - began)
        time.sleep(0.2)
    return {"requests": len(taken), "refused": refused, **waiting_times(taken)}


POISONED, _POISON, _SOUND = 20, "192.0.2.1", {"127.0.0.1": True}
"""Webhooks whose sending raises, and their address; those to which it doesn't."""


def deliver_beside() -> list[dict[str, Any]]:
    """Measure the time until a sound webhook is sent to, without and beside poisoned ones."""
    rows = []
    for count in (0, POISONED):
        with (
            tempfile.TemporaryDirectory(prefix="artiworld-webhooks-") as folder,
            closing(Store(Path(folder))) as store,
            socket.create_server(("127.0.0.1", 0)) as receiver,
        ):
            mia = store.people.accounts.add("mia", "manager", secrets.token_hex())
            for address in (*(_POISON,) * count, f"127.0.0.1:{receiver.getsockname()[1]}"):
                store.people.webhooks.add(mia, f"http://{address}/", ["object.rejected"], "mia")
            live = LiveSession(store, store.open_object(Path(folder, "a.ply"), None, "a").id)
            live.do(Reject("axis"), "mia")
            receiver.settimeout(LOST)
            begun = time.perf_counter()
            with closing(WebhookSender(store.people.webhooks, lambda ip: _SOUND[str(ip)])):
                receiver.accept()[0].close()
                taken = time.perf_counter() - begun
        rows.append({"with": f"{count} poisoned webhooks", "sent after s": round(taken, 2)})
    return rows


KINDS = ("uploaded", "sorted", "named", "accepted", "released")
MOST_DECISIONS = 3 * len(KINDS)
"""Before a kill; so many kinds are an object."""
LONGEST = 1.0
"""Seconds from a decision to a kill; the next one is there before."""
_CABINET = """<mujoco model="cabinet"><worldbody><body name="case">
<geom type="box" size="0.3 0.2 {height}" pos="0 0 0.5"/><body name="door" pos="-0.3 -0.22 0.5">
<joint name="hinge" axis="0 0 -1" range="0 90"/><geom type="box" size="0.3 0.01 0.3" pos="0.3 0 0"/>
</body></body></worldbody></mujoco>"""
_CODE = "import sys; from app.cli.benchmarks.faults import work; work(*sys.argv[1:])"


def kill_servers(kills: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Kill so many servers of one workspace.

    Returns:
        Counts of what was decided, and what of it is lost or left over, in words.
    """
    decided: list[list[str]] = []
    lost: list[str] = []
    left: set[str] = set()
    with tempfile.TemporaryDirectory(prefix="artiworld-kills-") as folder:
        workspace = Path(folder, "workspace")
        for number in range(kills):
            progress(number / kills, f"server {number + 1} of {kills}")
            decided += _killed(workspace, f"{seed}-{number}", random.Random(f"{seed}-{number}"))
            lost = _lost(workspace, decided)
            left |= {str(p.relative_to(workspace)) for p in unfinished(workspace)}
    count = {kind: sum(d[0] == kind for d in decided) for kind in KINDS}
    return {"kills": kills, **count, "lost": "; ".join(lost), "left over": "; ".join(sorted(left))}


def _killed(workspace: Path, name: str, rng: random.Random) -> list[list[str]]:
    """Run a server until a random moment; what it decided, each as words."""
    process = subprocess.Popen(
        [sys.executable, "-c", _CODE, str(workspace), name],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    said = [process.stdout.readline() for _ in range(rng.randint(1, MOST_DECISIONS))]
    with suppress(subprocess.TimeoutExpired):
        process.wait(rng.uniform(0.0, LONGEST))
    process.kill()
    said += process.stdout.read().splitlines(keepends=True)
    process.wait()
    return [line.split(" ", 2) for line in said[1:] if line.endswith("\n")]  # 0: it is ready


def _lost(workspace: Path, decided: list[list[str]]) -> list[str]:
    """Decisions that are missing in the workspace's next server."""
    state = AppState(ServeConfig(workspace=workspace), Store(workspace), [])
    try:
        queued = {record.id for record in state.queue.records()}
        return [" ".join(d).strip() for d in decided if not _is_there(state, queued, *d)]
    finally:
        state.close()
        state.store.close()


def _is_there(state: AppState, queued: set[int], kind: str, number: str, name: str = "") -> bool:
    document = state.store.load(int(number)).present
    if kind in ("named", "sorted"):
        return name.strip() in (document.part_names.get(1), document.category)
    saved = document.saved
    try:
        if kind == "released":
            check_release(state.workspace / "releases" / name.strip())
        elif kind == "accepted":
            whole = saved is not None and len(load_object(saved.folder).parts) == 2
            return whole and document.review.state == "accepted"
    except ArtiworldError:
        return False
    return int(number) in queued


def work(workspace: str, name: str) -> None:
    """Upload, sort (as bulk work), name, accept and release objects until killed; print each."""
    state = AppState(ServeConfig(workspace=Path(workspace)), Store(Path(workspace)), [])
    rng = random.Random(name)
    print("ready", flush=True)
    for number in range(1000):
        content = _CABINET.format(height=rng.uniform(0.3, 0.5)).encode()
        object_id = state.add_upload(f"cabinet-{name}-{number}.xml", content)
        print("uploaded", object_id, flush=True)
        obj = state.object(object_id)
        wait_for(lambda obj=obj: obj.document.segmentation_current and obj.document.tree, "joints")
        state.bulk.set_category([object_id], f"kind {name} {number}", "ann", lambda *_: None)
        wait_for(lambda: state.bulk.progress is None, "the bulk work")
        print("sorted", object_id, f"kind {name} {number}", flush=True)
        obj.do(NamePart(1, f"door {name} {number}"), "ann")
        print("named", object_id, f"door {name} {number}", flush=True)
        report = wait_for(lambda obj=obj: obj.validation.report, "validation")
        accept(obj, "", "ann", "as it is", seen=report)
        wait_for(lambda obj=obj: obj.document.saved, "the asset")
        print("accepted", object_id, flush=True)
        release, out = Release(name, f"{number}", "folder"), Path("releases", f"{name}-{number}")
        write_release(release, accepted_assets(state.store)[-3:], state.workspace / out)
        print("released", object_id, out.name, flush=True)


SECONDS = 60.0
"""Longest reading of a file of some kilobytes; USD may take half of it by itself."""
MEMORY = 4 << 30
"""Bytes that the reading process may take."""
MOST_UNPACKED = 100_000_000
"""Bytes of a zip."""
BAD = ("crash", "hang", "blow-up", "our fault")
SHOWN = 20


def faults_bench(options: FaultsBench, progress: Progress) -> Result:
    """Measure with the options of the command."""
    samples = fault_samples()
    counts: dict[str, Counter[str]] = {s.name: Counter() for s in samples}
    bad: list[dict[str, Any]] = []
    with (
        WorkerProcess(
            "faults", initializer=limit_process, arguments=(MEMORY,), threads=1
        ) as worker,
        tempfile.TemporaryDirectory(prefix="artiworld-faults-") as folder,
    ):
        for seed in range(options.seed, options.seed + options.limit):
            progress((seed - options.seed) / max(options.limit, 1), f"file of seed {seed}")
            sample = samples[seed % len(samples)]  # so that each format gets as many files
            outcome, message = _read(worker, sample, seed, Path(folder))
            counts[sample.name][outcome] += 1
            if outcome in BAD:
                bad.append({"seed": seed, "format": sample.name, "what": outcome, "why": message})
    rows = [
        {"format": name, "files": sum(n.values()), **{k: n[k] for k in ("read", "refused", *BAD)}}
        for name, n in counts.items()
    ]
    report = {"seed": options.seed, "files": options.limit, "rows": rows, "bad": bad}
    if options.kills:
        report["kills"] = kill_servers(options.kills, options.seed, progress)
    if options.clients:
        report["clients"] = click_beside(options.clients, options.seed, progress)
        report["strangers"] = ask_beside(options.clients)
        report["webhooks"] = deliver_beside()
    kills = report.get("kills", {})
    lost = any(row["lost"] for row in report.get("clients", ()))
    report["failed"] = bool(bad or lost or kills.get("lost") or kills.get("left over"))
    return Result(report, lambda: _print(report), int(report["failed"]))


def _read(worker: WorkerProcess, sample: FaultSample, seed: int, root: Path) -> tuple[str, str]:
    """Outcome and message of reading one damaged source."""
    rng = random.Random(f"{seed}")
    name = rng.choice([*sample.files, sample.main])
    folder = root / f"{seed}"
    folder.mkdir()
    for file, data in sample.files.items():
        (folder / file).write_bytes(damaged(data, rng) if file == name else data)
    try:
        job = worker.submit(
            read_source, folder / sample.main, sample.is_scene, most_seconds=SECONDS
        )
        job.result()
    except OutOfTimeError as error:
        return "hang", str(error)
    except ArtiworldError as error:
        return "blow-up" if "into memory" in str(error) else "refused", str(error)
    except WorkerDied as error:
        return "crash", str(error)
    except JobFailed as error:
        return "our fault", error.details or str(error)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return "read", ""


def read_source(path: Path, is_scene: bool) -> int:
    """Read a file, an upload or a scene as the server does; returns the number of what is in it.

    Raises:
        ArtiworldError: where it is refused.
    """
    if is_scene:
        scene = read_scene(path)
        unpack(scene, path.parent / "inside")
        return len(scene.objects)
    if path.suffix == ".zip":
        kept = keep_upload(path.parent / "uploads", path.name, path.open("rb"), MOST_UNPACKED)
        return sum(open_asset(found).element_count for found in find_assets([kept]))
    return open_asset(path).element_count


def _print(report: dict[str, Any]) -> None:
    print_records(f"{report['files']} damaged files from seed {report['seed']}", report["rows"])
    for entry in report["bad"][:SHOWN]:
        last = entry["why"].strip().splitlines()[-1:]
        said = f"seed {entry['seed']}: {entry['what']}: {entry['format']}: {' '.join(last)}"
        console().print(said, markup=False, highlight=False)
    if len(report["bad"]) > SHOWN:
        console().print(f"{len(report['bad']) - SHOWN} more, with --json")
    if "kills" in report:
        print_records("Servers killed at random moments", [report["kills"]])
    if "clients" in report:
        print_records("Clicks of six people", report["clients"])
        print_records("Requests of a person", report["strangers"])
        print_records("A message to a sound webhook", report["webhooks"])
