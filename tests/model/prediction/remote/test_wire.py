"""Requests and answers on the wire: exact for what is right, a clear refusal for the rest."""

import contextlib
import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from model.core.articulated_object import Part, Prediction, SegmentedObject
from model.core.errors import ArtiworldError
from model.core.geometry import Material, Mesh, PointCloud
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from model.prediction.remote_backend import (
    RequestError,
    decode_answer,
    decode_request,
    encode_answer,
    encode_request,
    read_header,
)

TRIANGLE = np.array([[0, 0, 0], [1 / 3, 0, 0], [0, np.pi, 0]])
LID = Joint("lid", "revolute", "link_0", "link_1", (0, 0.6, 0.8), (0.1, 0.2, 1 / 3), 0.0, 1.5)


def chest() -> SegmentedObject:
    red, blue = Material("red", (255, 0, 0, 255)), Material("blue", (0, 0, 255, 128))
    faces = np.array([[0, 1, 2], [2, 1, 0]])
    mesh = Mesh(TRIANGLE, faces, np.array([0, 1]), (red, blue))
    points = np.arange(12, dtype=np.float32).reshape(4, 3) / 7
    cloud = PointCloud(points, np.tile(np.float32([0, 0, 1]), (4, 1)), np.full((4, 3), 9, np.uint8))
    parts = (Part("link_0", mesh, None, "körper"), Part("link_1", None, cloud))
    return SegmentedObject("chest", parts, "Box")


def test_a_request_comes_back_exactly():
    hinge = replace(LID, mimic=Mimic("other", -2.0, 0.1))
    segmented, locked, seed = decode_request(encode_request(chest(), (hinge,), 7))
    assert (segmented.name, segmented.category, locked, seed) == ("chest", "Box", (hinge,), 7)
    assert [(p.link, p.name) for p in segmented.parts] == [("link_0", "körper"), ("link_1", None)]
    mesh, sent = segmented.parts[0].mesh, chest().parts[0].mesh
    assert mesh is not None and sent is not None
    assert np.array_equal(mesh.vertices, sent.vertices) and np.array_equal(mesh.faces, sent.faces)
    assert [m.base_color for m in mesh.materials] == [m.base_color for m in sent.materials]
    assert np.array_equal(mesh.face_material, sent.face_material)
    cloud, given_ = segmented.parts[1].cloud, chest().parts[1].cloud
    assert cloud is not None and given_ is not None
    for name in ("points", "normals", "colors"):
        assert np.array_equal(getattr(cloud, name), getattr(given_, name))


def test_a_texture_travels_as_colours_of_the_vertices():
    image = Image.new("RGB", (2, 1), (10, 20, 30))
    white = Material("t", (255, 255, 255, 255), image)
    mesh = Mesh(TRIANGLE, [[0, 1, 2]], materials=(white,), uv=np.zeros((3, 2), np.float32))
    sent = SegmentedObject("one", (Part("link_0", mesh),))
    got = decode_request(encode_request(sent, (), 0))[0].parts[0].mesh
    assert got is not None and got.vertex_colors is not None
    assert got.vertex_colors.tolist() == [[10, 20, 30, 255]] * 3


def test_an_answer_comes_back_exactly():
    tree = KinematicTree(("link_0", "link_1"), (LID,))
    answer = Prediction(
        tree, ("doubtful",), {"link_1": 0.25}, "geometric", 3, 1.5, "<json>", {"link_1": "a hinge"}
    )
    sent = json.loads(json.dumps(encode_answer(answer)))
    assert decode_answer(sent, chest()) == answer
    with pytest.raises(RequestError, match="invalid prediction"):
        decode_answer({**sent, "confidence": {"link_1": "high"}}, chest())
    with pytest.raises(RequestError, match="invalid prediction"):
        decode_answer([], chest())
    sent["tree"] = {"links": ["link_0"], "joints": []}
    with pytest.raises(RequestError, match="lacks the part 'link_1'"):
        decode_answer(sent, chest())


def archive(request: object, **arrays: np.ndarray) -> bytes:
    text = request if isinstance(request, bytes) else json.dumps(request).encode()
    out = io.BytesIO()
    np.savez(out, request=np.frombuffer(text, np.uint8), **arrays)  # type: ignore[arg-type]
    return out.getvalue()


HEADER = {"format": 1, "name": "x", "parts": [{"link": "link_0"}]}
TWICE = {"0.points": TRIANGLE, "1.points": TRIANGLE}
VERTICES = {"0.vertices": TRIANGLE, "0.faces": np.array([[0, 1, 2]])}


def _bomb() -> bytes:
    """An array whose header claims a terabyte."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as made:
        made.writestr("request.npy", _npy(np.frombuffer(json.dumps(HEADER).encode(), np.uint8)))
        head = _npy(np.zeros((1, 3))).replace(b"(1, 3)", b"(99999999999, 3)")
        made.writestr("0.points.npy", head)
    return out.getvalue()


def _npy(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no NPZ archive"),
        (b"PK\x05\x06 garbage", "no NPZ archive"),
        (archive(b"{"), "invalid request"),
        (archive(b"[" * 100_000), "invalid request"),
        (archive({**HEADER, "format": 2}), "format 2"),
        (archive({**HEADER, "seed": "x"}), "seed"),
        (archive({**HEADER, "parts": []}), "0 parts"),
        (archive({**HEADER, "locked": [{"name": "j"}]}), "locked"),
        (archive(HEADER), "needs a mesh or a cloud"),
        (archive(HEADER, **{"0.vertices": TRIANGLE}), "invalid array"),
        (archive(HEADER, **{**VERTICES, "0.faces": np.array([[0, 1, 9]])}), "0..9"),
        (archive(HEADER, **{"0.points": np.full((2, 3), np.nan)}), "NaN"),
        (archive(HEADER, **{"0.points": np.zeros((2, 2))}), "shape"),
        (archive(HEADER, **{"0.points": np.array([["a", "b", "c"]])}), "contradicts"),
        (archive(HEADER, **{"0.points": np.array([[print, 1, 2]], object)}), "contradicts"),
        (archive(HEADER, **{**VERTICES, "0.base_colors": np.zeros((1, 3), np.uint8)}), "invalid"),
        (_bomb(), "damaged|contradicts its header"),
        (archive({**HEADER, "parts": [{"link": "a"}] * 2}, **TWICE), "same link name"),
    ],
    ids=range(18),
)
def test_what_is_no_request_is_refused(data, words):
    with pytest.raises(ArtiworldError, match=words):
        decode_request(data)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(0, 255))
def test_a_damaged_request_never_breaks_the_reader(place, value):
    data = bytearray(encode_request(chest(), (LID,), 1))
    data[place % len(data)] = value
    for read in (read_header, decode_request):
        with contextlib.suppress(ArtiworldError):
            read(bytes(data))
