"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Two busy cores: numeric libraries with a thread pool each make tests slower and less even.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

ROOT = Path(__file__).resolve().parents[1]

SLOW = (
    "tests/browser/",
    "tests/legacy/",
    "tests/model/training/",
    "tests/model/validation/",
    "tests/app/test_backend.py",
    "tests/app/test_backend_away.py",
    "tests/app/test_bad_input.py",
    "tests/app/test_bench_command.py",
    "tests/app/test_bench_networks.py",
    "tests/app/test_cli.py",
    "tests/app/test_doctor.py",
    "tests/app/test_documents.py",
    "tests/app/test_evaluate_command.py",
    "tests/app/test_interrupt.py",
    "tests/app/test_jobs.py",
    "tests/app/test_open_objects.py",
    "tests/app/test_opened_urdf.py",
    "tests/app/test_preemption.py",
    "tests/app/test_saving_tasks.py",
    "tests/app/test_scene_command.py",
    "tests/app/test_scene_formats.py",
    "tests/app/test_scene_workspace.py",
    "tests/app/test_serve_command.py",
    "tests/app/test_tool_tasks.py",
    "tests/app/test_validating.py",
    "tests/model/io/test_urdf_reader.py",
    "tests/model/kinematics/test_sweep.py",
    "tests/model/physics/test_collision_shapes.py",
    "tests/model/physics/test_simulated.py",
    "tests/model/prediction/arti4urdf/test_arti4urdf_predictor.py",
    "tests/model/prediction/arti4urdf/test_full_model.py",
    "tests/model/prediction/arti4urdf/test_grammar.py",
    "tests/model/prediction/arti4urdf/test_text_script.py",
    "tests/model/prediction/arti4urdf/test_weights.py",
    "tests/model/prediction/geometric/test_archetypes.py",
    "tests/model/prediction/geometric/test_geometric_predictor.py",
    "tests/model/scenes/test_language_finder.py",
    "tests/model/segmentation/test_attached_shells.py",
    "tests/model/segmentation/test_box_scores.py",
    "tests/model/segmentation/test_boxes.py",
    "tests/model/segmentation/test_coincident_faces.py",
    "tests/model/segmentation/test_contract.py",
    "tests/model/segmentation/test_default_segmenter.py",
    "tests/model/segmentation/test_fronts.py",
    "tests/model/segmentation/test_local_refinement.py",
    "tests/model/segmentation/test_outliers.py",
    "tests/model/segmentation/test_part_masks.py",
    "tests/model/segmentation/test_proposal_sources.py",
    "tests/model/segmentation/test_rooms.py",
    "tests/model/segmentation/test_simulated_clicks.py",
    "tests/model/segmentation/test_small_components.py",
    "tests/model/segmentation/test_superpoint_colors.py",
    "tests/model/segmentation/test_tools.py",
    "tests/model/test_bundled_refrigerator.py",
)
"""Tests with a browser, physics, training, other processes, or much to compute: files that take
over four seconds by ``pytest --durations=0``. ``make test-fast`` leaves them out."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what :data:`SLOW` names."""
    for item in items:
        if item.path.relative_to(ROOT).as_posix().startswith(SLOW):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real scans and objects that is not part of the project; skips where absent."""
    folder = Path(os.environ.get("ARTIWORLD_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder} (set ARTIWORLD_SHARED_DATA to its folder)")
    return folder
