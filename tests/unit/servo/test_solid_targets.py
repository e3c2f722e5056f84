"""Solid targets: servoing by the pose of a mesh, and errors."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "camera"))

from tracking_scenes import corners_of, write_obj

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.targets.target_factory import make_target
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.settings import Settings


# A camera with fx != fy whose lens bends lines by up to 20 px.
@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """The path of each solid's OBJ file, and of bad ones."""
    folder, found = tmp_path_factory.mktemp("meshes"), {}
    for name in ("box", "bracket"):
        found[name] = str(write_obj(folder / f"{name}.obj", [(corners_of(name), 0.6)]))
    box = corners_of("box")
    bad = {"millimetres": 1e3 * box, "open": box[2:], "inside": box[:, ::-1]}
    for name, triangles in bad.items():
        found[name] = str(write_obj(folder / f"{name}.obj", [(triangles, 0.6)]))
    return found


def flying(mesh, **more):
    """A flying camera that sees the solid aslant."""
    return Experiment(
        plant="free", features="images", scheme="pose", target={"shape": mesh},
        camera={"width": 640, "height": 480, "horizontal_fov": 0.9},
        goal={"pose": [0.05, -0.2, 0.33, -2.6, 0.0, 0.0]},
        start={"pose": [0.09, -0.22, 0.4, -2.45, 0.06, 0.4]}, **more,
    )  # fmt: skip


@pytest.mark.parametrize("scheme", ["model", "numbered_points"])
def test_schemes_of_poses_and_points_go_to_a_solid(meshes, scheme):
    result = run(
        flying(meshes["bracket"], calibration_offset={"centre": [0.4, -0.3]}).with_changes(
            scheme=scheme
        )
    )
    assert result.converged
    assert result.verdict.distance < 3e-4
    assert result.verdict.angle < 1e-3


def test_the_arm_goes_to_a_solid_on_its_table(meshes):
    """From a rough start of the tracker, with depth images."""
    target = {"shape": meshes["bracket"], "pose": [0.0, 0.0, 0.5905, 0.0, 0.0, 0.3]}
    starts = {"height": [0.2, 0.3], "side": 0.04, "turn": 0.7, "tilt": 0.15, "margin": 4}
    rough = {"pose": [0.004, -0.003, 0.5925, 0.02, 0.0, 0.33]}
    result = run(Experiment(
        target=target, scheme="pose", start=starts, seed=3, duration=12.0,
        controller_parameters={"model_start": rough, "depth_image": True},
    ))  # fmt: skip
    assert result.outcome.startswith("converged")
    assert result.verdict.distance < 2e-4
    assert result.verdict.angle < 1e-3


@pytest.mark.parametrize(("name", "why"), [
    ("millimetres", "80 m long: is it in millimetres"),
    ("open", "not a closed surface"),
    ("inside", "inside out"),
])  # fmt: skip
def test_a_mesh_that_is_no_solid_is_refused(meshes, name, why):
    with pytest.raises(ExperimentError, match=why):
        assemble(flying(meshes[name]))


def test_what_a_solid_cannot_be_is_said(meshes):
    with pytest.raises(ExperimentError, match="no file"):
        assemble(flying("nowhere.stl"))
    near = flying(meshes["box"]).with_changes(goal={"pose": [0.0, 0.0, 0.075, 3.1416, 0.0, 0.0]})
    with pytest.raises(ExperimentError, match="larger than the image"):
        assemble(near)
    with pytest.raises(ExperimentError, match="leave them out"):
        flying(meshes["box"]).with_changes(target={"shape": meshes["box"], "perturbed": True})
    with pytest.raises(ConfigurationError, match="set the parameter model to a file"):
        Settings.from_mapping(
            {"tracker": "model", "model_start": {"pose": [0] * 6}}).make_tracker()
    with pytest.raises(ConfigurationError, match="must define the start pose"):
        Settings.from_mapping({"tracker": "model", "model": meshes["box"]}).make_tracker()
    with pytest.raises(ConfigurationError, match="must define the start pose"):
        Settings.from_mapping({"model": meshes["box"]}).make_tracker()  # it names the tracker


def test_a_target_that_is_gone_is_said_to_be_lost(meshes):
    asked = flying(meshes["box"]).with_changes(
        target={"shape": meshes["box"], "motion": {"step": [0.12, 0.05, 0.0], "begin": 0.5}})
    result = run(asked)
    assert not result.converged
    name = Path(meshes["box"]).name  # and not the folder, which may be a temporary one
    assert any(f"{name} is lost: " in reason and f"/{name}" not in reason
               for reason in result.reasons)


TAG = (0.012, 0.0, 0.0603), (0.0, 0.0, 0.0)  # box_T_tag: m; roll, pitch, yaw
MARKED = 0.045  # m, of the picture on the box; eight of its ten cells are the black square


@pytest.fixture(scope="module")
def marked(tmp_path_factory):
    """Box of 0.08 x 0.05 x 0.06 m on z = 0, with a marker off the centre of its top."""
    folder = tmp_path_factory.mktemp("marked")
    path = write_obj(folder / "marked.obj", [(corners_of("box"), 0.6)])
    cv2.imwrite(str(folder / "tag.png"), make_target("marker", (MARKED, MARKED)).pixels)
    with path.with_suffix(".mtl").open("a") as file:
        file.write("\nnewmtl tag\nKd 1 1 1\nmap_Kd tag.png\n")
    turn = matrix_from_xyz_rpy(*TAG)
    flat = 0.5 * MARKED * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = np.column_stack([flat, np.zeros(4)]) @ turn[:3, :3].T + turn[:3, 3]
    # A closed slab of 0.2 mm, so that the solid is two closed parts.
    ring = [*corners, *(corners - (0.0, 0.0, 2e-4))]
    lines = [f"v {x} {y} {z}" for x, y, z in ring]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines += ["usemtl tag", "f -8/1 -7/2 -6/3", "f -8/1 -6/3 -5/4", "usemtl m0"]
    sides = [(-4, -2, -3), (-4, -1, -2)]
    for a, b in ((-8, -7), (-7, -6), (-6, -5), (-5, -8)):
        sides += [(a, a + 4, b + 4), (a, b + 4, b)]
    lines += ["f " + " ".join(map(str, side)) for side in sides]
    with path.open("a") as file:
        file.write("\n".join(lines) + "\n")
    return str(path)


def test_a_marker_on_it_tells_where_it_is_at_first(marked):
    start = {"marker": {"size": 0.8 * MARKED, "pose": [*TAG[0], *TAG[1]]}}
    asked = flying(marked, controller_parameters={"model_start": start})
    result = run(asked)
    assert result.converged
    assert result.verdict.distance < 3e-4
    assert result.verdict.angle < 1e-3
    gone = asked.with_changes(target={"shape": str(Path(marked).with_name("plain.obj"))})
    write_obj(Path(gone.target.shape), [(corners_of("box"), 0.6)])
    with pytest.raises(ExperimentError, match="no marker of .* is in view"):
        assemble(gone)
