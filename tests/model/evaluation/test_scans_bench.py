"""The bench of reconstructed scans also measures what preparing removes of clean ones."""

from model.data.registry import DatasetOptions
from model.evaluation.scans import CLEAN, ScansConfig, run, table


def test_clean_scans_of_bundled_objects_lose_less_than_half_a_percent() -> None:
    data = DatasetOptions("bundled")
    scores = run(ScansConfig(data, "choose", limit=2, frames=tuple(CLEAN), points=10_000, jobs=1))
    rows = list(table(scores))
    assert [row["frame"] for row in rows] == list(CLEAN)
    for row in rows:
        assert row["objects"] == 2 and row["kept 99.5%"] == row["up within 2°"] == 1
