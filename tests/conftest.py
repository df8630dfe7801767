"""What all tests share."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Two busy cores: numeric libraries with a thread pool each make tests slower and less even.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# A busy machine is no failure.
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

ROOT = Path(__file__).resolve().parents[1]

SLOW = (
    "tests/browser/test_main_job.py",
    "tests/model/training/test_experience.py",
    "tests/app/test_learn_command.py",
    "tests/browser/test_review_gate.py",
    "tests/browser/test_tools.py",
    "tests/browser/test_room.py",
    "tests/browser/",
    "tests/app/test_scene_workspace.py",
    "tests/app/test_validating.py",
    "tests/model/training/",
    "tests/model/segmentation/test_default_segmenter.py",
    "tests/model/segmentation/test_contract.py",
    "tests/model/physics/test_simulated.py",
    "tests/model/physics/test_affordances.py",
    "tests/model/evaluation/test_robot_bench.py",
    "tests/app/test_scene_command.py",
    "tests/app/test_scene_formats.py",
    "tests/app/test_cli.py",
    "tests/test_base_installation.py",
    "tests/app/test_documents.py",
    "tests/model/physics/test_collision_shapes.py",
    "tests/model/segmentation/test_fronts.py",
    "tests/model/segmentation/test_rooms.py",
    "tests/model/validation/",
    "tests/app/test_opened_urdf.py",
    "tests/legacy/",
    "tests/app/test_api.py",
    "tests/app/test_attacks.py",
    "tests/app/test_backend.py",
    "tests/app/test_backend_away.py",
    "tests/app/test_bench_faults.py",
    "tests/app/test_bad_input.py",
    "tests/app/test_bench_command.py",
    "tests/app/test_bench_networks.py",
    "tests/app/test_bench_team.py",
    "tests/app/test_comments.py",
    "tests/app/test_completed_assets.py",
    "tests/app/test_doctor.py",
    "tests/app/test_ending.py",
    "tests/app/test_evaluate_command.py",
    "tests/app/test_full_workspace.py",
    "tests/app/test_routes.py::test_no_route_waits",
    "tests/app/test_interleaved_decisions.py",
    "tests/app/test_interrupt.py",
    "tests/app/test_jobs.py",
    "tests/app/test_lanes.py",
    "tests/app/test_leftovers.py",
    "tests/app/test_likeness.py",
    "tests/app/test_masks.py",
    "tests/app/test_oidc.py",
    "tests/app/test_open_objects.py",
    "tests/app/test_opened_mjcf.py::test_commands_take_it",
    "tests/app/test_preemption.py",
    "tests/app/test_preparing.py",
    "tests/app/test_project_settings.py",
    "tests/app/test_saving_tasks.py",
    "tests/app/test_scene_reading.py",
    "tests/app/test_serve_command.py",
    "tests/app/test_several_servers.py",
    "tests/app/test_storage.py",
    "tests/app/test_tool_tasks.py",
    "tests/app/test_up_axis.py",
    "tests/model/data/test_partnet_mobility.py::test_real_objects",
    "tests/model/data/test_procedural_objects.py::test_joints_move",
    "tests/model/evaluation/test_evaluation_run.py",
    "tests/model/evaluation/test_pool.py",
    "tests/model/evaluation/test_predictions.py::test_real_objects",
    "tests/model/evaluation/test_reports.py",
    "tests/model/evaluation/test_rival_urdfs.py",
    "tests/model/evaluation/test_assets_bench.py",
    "tests/model/evaluation/test_rivals.py",
    "tests/model/evaluation/test_visible_clicks.py::test_the_benchmark",
    "tests/model/evaluation/test_visible_clicks.py::test_a_person",
    "tests/model/geometry/test_completion.py",
    "tests/model/geometry/test_display_and_sampling.py::test_a_million",
    "tests/model/geometry/test_picking.py::test_cloud_pick_among_a_million",
    "tests/model/io/test_asset_folder.py::test_a_part_of_few_points",
    "tests/model/io/test_asset_folder.py::test_a_scanned_part",
    "tests/model/io/test_asset_folder.py::test_real_objects",
    "tests/model/io/test_asset_folder.py::test_an_asset_with_shapes",
    "tests/model/io/test_round_trips.py",
    "tests/model/io/test_damaged_files.py::test_damaged_bytes",
    "tests/model/io/test_exporters.py",
    "tests/model/io/test_hostile_pickles.py",
    "tests/model/io/test_mjcf_reader.py::test_an_export_of_ours",
    "tests/model/io/test_real_data.py",
    "tests/model/io/test_simready.py",
    "tests/model/io/test_urdf_poses.py",
    "tests/model/io/test_urdf_reader.py",
    "tests/model/kinematics/test_sweep.py",
    "tests/model/prediction/arti4urdf/",
    "tests/model/prediction/geometric/test_archetypes.py",
    "tests/model/prediction/geometric/test_geometric_predictor.py",
    "tests/model/prediction/geometric/test_noise.py::test_noisy_keys",
    "tests/model/prediction/geometric/test_odd_part_sets.py",
    "tests/model/scenes/test_language_finder.py",
    "tests/model/segmentation/test_attached_shells.py",
    "tests/model/segmentation/test_boxes.py",
    "tests/model/segmentation/test_coincident_faces.py",
    "tests/model/segmentation/test_outliers.py",
    "tests/model/segmentation/test_point_sam.py",
    "tests/model/segmentation/test_part_masks.py",
    "tests/model/segmentation/test_proposal_sources.py",
    "tests/model/segmentation/test_simulated_clicks.py",
    "tests/model/segmentation/test_small_components.py",
    "tests/model/segmentation/test_superpoint_colors.py",
    "tests/model/segmentation/test_tools.py",
    "tests/model/segmentation/test_trees.py",
    "tests/model/test_bundled_refrigerator.py",
    "tests/sessions/test_session_properties.py",
    "tests/sessions/test_store_processes.py",
    "tests/sessions/test_store_postgresql.py",
    "tests/sessions/test_releases.py",
    "tests/app/test_release_command.py",
    "tests/sessions/test_quality.py",
    "tests/model/geometry/test_like_object.py",
    "tests/model/geometry/test_prepare.py",
    "tests/model/data/test_procedural_scans.py",
    "tests/model/io/test_budgets.py",
    "tests/model/io/test_masks.py",
)
"""Beginnings of the names of tests with a browser, physics, training or much to compute, the
longest first by ``pytest --durations=0``. ``make test-fast`` leaves them out."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Don't import slow files where they aren't wanted: that takes half a minute."""
    if config.getoption("markexpr") == "not slow":
        name = collection_path.relative_to(ROOT).as_posix() + "/" * collection_path.is_dir()
        return name.startswith(SLOW) or None
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what :data:`SLOW` names, and run it first, so that workers end at the same time."""
    place = {item: _place(item.nodeid) for item in items}
    for item, at in place.items():
        if at < len(SLOW):
            item.add_marker(pytest.mark.slow)
        if item.nodeid.startswith("tests/browser/"):
            item.add_marker(pytest.mark.browser)
    # Tests of one file stay together, as they share fixtures.
    first: dict[str, int] = {}
    for item, at in place.items():
        file = item.nodeid.split("::")[0]
        first[file] = min(at, first.get(file, at))
    items.sort(key=lambda item: first[item.nodeid.split("::")[0]])


def _place(name: str) -> int:
    """The index in :data:`SLOW` of what ``name`` begins with."""
    return next((i for i, start in enumerate(SLOW) if name.startswith(start)), len(SLOW))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real scans and objects that is not part of the project; skips where absent."""
    folder = Path(os.environ.get("ARTIWORLD_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no shared data at {folder} (set ARTIWORLD_SHARED_DATA to its folder)")
    return folder


@pytest.fixture(scope="session")
def workers_of_all_servers() -> Iterator[None]:
    """Processes that the servers of all tests share."""
    from tests.app.shared_workers import shared_workers

    with shared_workers():
        yield
