"""Files after public bug reports of other tools are read as their README says, or told; those of
USD are in ``test_usd_reports``."""

from pathlib import Path

import numpy as np
import pytest

from model.core.errors import InputFileError
from model.io.open_asset import open_asset
from tests.model.io.test_changed_values import facts, same, stated
from tests.model.io.test_format_tables import plain

REPORTS = Path(__file__).parents[4] / "shared" / "public_reports"
RIGHT = """
e57_16bit_colours/cabinet.e57 => colours: #ff8000ff
e57_colour_invalid/cabinet.e57 => ! the colours of 2,000 points are marked as invalid
e57_float_colours/cabinet.e57 => colours: #ff8000ff
e57_mixed_colours/cabinet.e57 => ! 1 of 2 stations without colours
e57_mixed_colours/cabinet.e57 => size: 0.8 0.6 1.2
glb_instancing/glb_instancing_parts/chest.glb => faces: 60; parts: body drawer drawer drawer drawer
glb_meshopt/glb_meshopt_EXT/m.glb => ! EXT_meshopt_compression
glb_morph/glb_morph/stretch.glb => size: 1 1 2
glb_points_lines/glb_points_lines/mixed.glb => ! 500 points beside
glb_points_lines/glb_points_lines/mixed.glb => ! lines
glb_skinned/glb_skinned_bind/chest.glb => size: 0.6 0.4 1
las_survey_feet/cabinet.las => size: 0.8 0.6 1.2
las_withheld_noise/cabinet.laz => points: 4000; size: 0.8 0.6 1.2
mjcf_builtin_texture/mj_texture_cube/cab.xml => ! the built-in texture 't'
mjcf_polycoef/lid.xml => ! along a curve
mjcf_polycoef/lin.xml => follows jb: -0.5 0.2
mjcf_polycoef/free.xml => kind ja: continuous; range ja: free
obj_bom/obj_bom_mtl_only/model.obj => faces: 12; colours: #ff0000ff
obj_bom/obj_bom_mtllib/model.obj => faces: 12; colours: #ff0000ff
obj_inline_comment/obj_inline_comment/m.obj => faces: 12; size: 1 1 1
obj_multi_mtllib/obj_multi_mtllib/m.obj => colours: #0000ffff #00ff00ff #ff0000ff
obj_texture_modes/cmyk.obj => colours: #ff8000ff
obj_texture_modes/exif.obj => colours: #0000ffff #ff0000ff
obj_texture_modes/i16.obj => colours: #808080ff
obj_texture_modes/la.obj => colours: #808080ff
obj_texture_modes/one.obj => colours: #ffffffff
obj_texture_modes/p.obj => colours: #ff8000ff
obj_vertex_colours/bytes.obj => colours: #c86432ff
obj_vertex_colours/four.obj => colours: #c86432ff
obj_vertex_colours/unit.obj => colours: #c86432ff
ply_tristrips/ply_tristrips/scan.ply => faces: 12; size: 1 1 1
ply_two_textures/ply_meshlab_two_textures/m.ply => colours: #0000ffff #ff0000ff
sdf_joint_on_frame/cabinet.sdf => at hinge: -0.4 -0.31 0.5
sdf_joint_to_world/base_and_door.sdf => range hinge: -1.5 0
sdf_joint_to_world/cabinet.sdf => range hinge: -1.5 0
sdf_materials/cabinet.sdf => ! 'Gazebo/Red'
sdf_materials/cabinet.sdf => colours door: #0000ff66
sdf_nested_model/cabinet.sdf => at hinge: -0.4 -0.31 0
sdf_nested_model/wrapper.sdf => at hinge: 0.6 -0.31 0
sdf_parts_of_mesh/model.sdf => size base: 0.6 0.4 0.8; size door: 0.6 0.02 0.8
sdf_static/cabinet.sdf => ! Gazebo moves nothing
small_box => parts: base lid
stl_upper_bom/stl_ascii_upper/a.STL => faces: 12
urdf11_quat/urdf11_quat/cab.urdf => box door: -0.32 -0.8 0 -0.3 -0.2 0.8
urdf_dae/urdf_mesh_dae/cab.urdf => parts: base door
urdf_dynamics_all/cabinet.urdf => damping hinge: 0.7; friction hinge: 0.2; effort hinge: 10
urdf_limit_effort_only/urdf_limit_effort_only/cab.urdf => ! states neither lower nor upper
urdf_limits_zero/cab.urdf => ! predict
urdf_mimic_no_limit/urdf_mimic_no_limit/cab.urdf => range h2: -1.57 0; follows h2: -1 0
urdf_mimic_offset/urdf_mimic_offset2/cab.urdf => follows h2: 1 0.5
urdf_missing_mesh/empty.urdf => ! 'new-2.obj'
urdf_missing_mesh/mobility.urdf => ! 'new-1.obj'
urdf_missing_mesh/mobility.urdf => size door: 0.8 0.02 1
urdf_texture/urdf_texture/cab.urdf => colours base: #ff0000ff
"""


@pytest.mark.parametrize("row", RIGHT.strip().split("\n"))
def test_files_after_public_reports(row: str) -> None:
    name, says = row.split(" => ")
    if not (REPORTS / name).exists():
        pytest.skip("needs the shared public reports")
    try:
        asset = open_asset(REPORTS / name)
    except InputFileError as error:
        assert says.startswith("! ") and says[2:] in str(error)
        return
    if says.startswith("! "):
        assert says[2:] in " | ".join(asset.warnings)
        return
    found = plain(asset) | (facts(asset) if asset.tree is not None else {})
    for what in [key for key in found if key.startswith("box")]:
        found[what.replace("box", "size")] = np.diff(np.reshape(found[what], (2, 3)), axis=0)[0]
    assert {k: v for k, v in stated(says).items() if not same(v, found.get(k))} == {}
