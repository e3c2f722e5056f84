"""Solid targets: servoing by a mesh's pose, by a silhouette, and by a link of the world."""

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
from aras_visual_servo_controller.settings import ControllerSettings


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    folder, box = tmp_path_factory.mktemp("meshes"), corners_of("box")
    solids = {"box": box, "bracket": corners_of("bracket"), "millimetres": 1e3 * box,
              "open": box[2:], "inside": box[:, ::-1]}  # fmt: skip
    return {name: str(write_obj(folder / f"{name}.obj", [(triangles, 0.6)]))
            for name, triangles in solids.items()}  # fmt: skip


def reaches(experiment, distance, angle=1e-3):
    result = run(experiment.with_changes(gain=4.0, time_after_convergence=0.0))
    assert result.outcome.startswith("converged"), result.outcome
    assert result.verdict.distance < distance and result.verdict.angle < angle


def flying(mesh, **more):
    """A flying camera that sees the solid aslant."""
    return Experiment(
        plant="free", features="images", scheme="pose", target={"shape": mesh},
        camera={"width": 640, "height": 480, "horizontal_fov": 0.9},
        goal={"pose": [0.05, -0.2, 0.33, -2.6, 0.0, 0.0]},
        start={"pose": [0.09, -0.22, 0.4, -2.45, 0.06, 0.4]}, **more)  # fmt: skip


def test_points_of_a_solid_lead_to_it(meshes):
    asked = flying(meshes["bracket"], calibration_offset={"centre": [0.4, -0.3]})
    reaches(asked.with_changes(scheme="numbered_points"), 3e-4)


def test_the_arm_goes_to_a_solid_on_its_table(meshes):
    """From a rough start of the tracker, with depth images."""
    target = {"shape": meshes["bracket"], "pose": [0.0, 0.0, 0.5905, 0.0, 0.0, 0.3]}
    starts = {"height": [0.2, 0.3], "side": 0.04, "turn": 0.7, "tilt": 0.15, "margin": 4}
    rough = {"pose": [0.004, -0.003, 0.5925, 0.02, 0.0, 0.33]}
    reaches(Experiment(target=target, scheme="pose", start=starts, seed=3, duration=12.0,
                       controller_parameters={"model_start": rough, "depth_image": True}), 2e-4)


@pytest.mark.parametrize(("name", "why"), [
    ("millimetres", "80 m long: is it in millimetres"), ("open", "not a closed surface"),
    ("inside", "inside out"), ("nowhere", "no file"),
])  # fmt: skip
def test_a_mesh_that_is_no_solid_is_refused(meshes, name, why):
    with pytest.raises(ExperimentError, match=why):
        assemble(flying(meshes.get(name, "nowhere.stl")))


def test_what_a_solid_cannot_be_is_said(meshes):
    near = flying(meshes["box"]).with_changes(goal={"pose": [0.0, 0.0, 0.075, 3.1416, 0.0, 0.0]})
    with pytest.raises(ExperimentError, match="larger than the image"):
        assemble(near)
    with pytest.raises(ExperimentError, match="leave them out"):
        flying(meshes["box"]).with_changes(target={"shape": meshes["box"], "perturbed": True})
    for given, why in (
        ({"tracker": "model", "model_start": {"pose": [0] * 6}}, "set the parameter model to a f"),
        ({"tracker": "model", "model": meshes["box"]}, "must define the start pose"),
        ({"model": meshes["box"]}, "must define the start pose"),  # it names the tracker
    ):
        with pytest.raises(ConfigurationError, match=why):
            ControllerSettings.from_mapping(given).make_tracker()


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
    reaches(asked, 3e-4)
    gone = asked.with_changes(target={"shape": str(Path(marked).with_name("plain.obj"))})
    write_obj(Path(gone.target.shape), [(corners_of("box"), 0.6)])
    with pytest.raises(ExperimentError, match="no marker of .* is in view"):
        assemble(gone)


# -- solids servoed by silhouette moments, segmented by label, colour and grey level ------------
ROUND = "gravity_centre_normalised+area_normalised"  # of what has no main axis
LABEL = {"method": "label"}
LEVEL = 0.59  # m, of the table's top
SIZES = {"box": [0.08, 0.05, 0.06], "sphere": [0.06, 0.06, 0.06]}


def on_the_table(shape, segmentation, seed=4, **more):
    """The arm above a solid, aside from its middle, at most 0.2 m nearer or farther."""
    size = SIZES.get(shape)
    at = LEVEL + 5e-4 + (size[2] / 2 if size else 0.0)
    target = {"shape": shape, "pose": [0.0, 0.0, at, 0.0, 0.0, 0.3]}
    if size:
        target["size"] = size
    return Experiment(**{
        "target": target, "controller_parameters": {"segmentation": segmentation},
        "duration": 12.0,
        "goal": {"pose": [0.03, -0.02, LEVEL + 0.3, np.pi, 0.0, 0.0]}, "seed": seed,
        "start": {"height": [0.28, 0.4], "side": 0.05, "turn": 0.6, "margin": 4}, **more,
    })  # fmt: skip


RED = {"method": "colour", "colour_low": [170, 100, 30], "colour_high": [10, 255, 255]}


@pytest.mark.parametrize(("shape", "segmentation", "given"), [
    ("sphere", LABEL, {"scheme": ROUND}), ("red", RED, {"scheme": "moments"}),
    ("box", LABEL, {"plant": "free", "features": "images", "scheme": "moments",
                    "camera": "calibrated",  # with a lens
                    "start": {"pose": [0.06, -0.05, LEVEL + 0.37, 3.1, 0.04, 0.4]}}),
])  # fmt: skip
def test_a_solid_is_reached_by_its_label_or_its_colour(shape, segmentation, given, tmp_path):
    if shape == "red":
        path = write_obj(tmp_path / "red.obj", [(corners_of("box"), 0.6)])
        path.with_suffix(".mtl").write_text("newmtl m0\nKd 0.7 0.1 0.1\n")
        shape = str(path)
    far = 1.5e-4 if segmentation is LABEL else 3e-4
    reaches(on_the_table(shape, segmentation, **given), far, np.radians(0.3))


def test_where_no_plane_fits_it_is_said_before_the_run():
    tall = on_the_table("box", LABEL, plant="free", features="images").with_changes(
        target={"shape": "box", "size": [0.08, 0.05, 0.24], "pose": [0.0] * 6},
        goal={"pose": [0.03, 0.03, 0.34, np.pi - 0.3, 0.1, 0.0]})
    with pytest.raises(ExperimentError, match=r"visible outline of box.*22 %.*'model'"):
        assemble(tall)
    assemble(tall.with_changes(scheme="pose")).plant.close()


@pytest.mark.parametrize(("segmentation", "changes", "why"), [
    ({"method": "labels"}, {}, "segmentation.method is 'labels': did you mean 'label'"),
    ({"component": "mask"}, {}, "is for the camera node"),
    ({"method": "label", "label": "targt"}, {}, "no link has the label 'targt': did you mean 'tar"),
    ({"method": "colour"}, {"plant": "free", "features": "images"},
     "images of plant 'free' are grey"),
    (LABEL, {"target": {"shape": "box", "size": [0.1, 0.1], "pose": [0, 0, 0.6, 0, 0, 0]}},
     "must be three lengths, along x, y and z"),
    (LABEL, {"target": {"shape": "square", "size": [0.1] * 3, "pose": [0, 0, 0.6, 0, 0, 0]}},
     "must be two lengths"),
])  # fmt: skip
def test_what_cannot_be_is_said_in_one_line(segmentation, changes, why):
    changes = {"controller_parameters": {"segmentation": segmentation}, **changes}
    with pytest.raises(ExperimentError, match=why):
        assemble(on_the_table("box", LABEL, scheme="moments").with_changes(**changes))


# -- a link of a model in a world file as the target --------------------------------------------
PLANE = "<geometry><plane><normal>0 0 1</normal></plane></geometry>"
BOX = "<geometry><box><size>{}</size></box></geometry>"
LOOKS = "<material><ambient>0.7 0.1 0.1 1</ambient><diffuse>0.7 0.1 0.1 1</diffuse></material>"
SIZE = "0.08 0.05 0.06"
WORLD = f"""<?xml version="1.0"?>
<sdf version="1.6"><world name="a">
<light name="sun" type="directional">
  <direction>-0.3 0.2 -1</direction><diffuse>0.8 0.8 0.8 1</diffuse>
</light>
<model name="ground_plane"><static>1</static><link name="link">
  <collision name="c">{PLANE}</collision><visual name="v">{PLANE}</visual></link></model>
<model name="crate"><pose>0.02 0.01 HEIGHT 0 0 0.4</pose>
  <link name="body"><pose>0 0 0 0 0 0.2</pose>
    <inertial><mass>0.5</mass>
      <inertia><ixx>0.001</ixx><iyy>0.001</iyy><izz>0.001</izz></inertia></inertial>
    <collision name="c">{BOX.format(SIZE)}</collision>
    <visual name="v">{BOX.format(SIZE)}{LOOKS}</visual></link>
  MORE
</model></world></sdf>"""
LID = f"""<link name="lid"><pose>0.3 0 0 0 0 0</pose>
  <visual name="v">{BOX.format('0.05 0.05 0.01')}</visual></link>
  <joint name="j" type="fixed"><parent>body</parent><child>lid</child></joint>"""


@pytest.fixture
def world(tmp_path):
    """Writes the world with the crate's middle at a height, m, and more in its model."""
    def written(height=0.6205, more=""):
        path = tmp_path / f"{height}.world"
        path.write_text(WORLD.replace("HEIGHT", str(height)).replace("MORE", more))
        return str(path)
    return written


def before(world, **more):
    return Experiment(**{
        "world": world, "target": {"model": "crate"}, "gain": 2.0, "duration": 10.0,
        "scheme": "moments", "controller_parameters": {"segmentation": {"method": "label"}},
        "goal": {"pose": [0.03, -0.02, 0.89, np.pi, 0.0, 0.0]}, "seed": 2,
        "start": {"height": [0.28, 0.4], "side": 0.05, "turn": 0.6, "margin": 4}, **more,
    })  # fmt: skip


def test_a_crate_of_the_world_that_falls_is_followed(world):
    """That the arm goes there, docs/solid_targets.md shows."""
    height = 0.64
    result = run(before(world(height), duration=0.6))
    first, last = (result.target.world_T_target(time) for time in (0.0, 8.0))
    assert first[:3, 3] == pytest.approx([0.02, 0.01, height], abs=1e-6)
    assert last[:3, 3] == pytest.approx([0.02, 0.01, 0.62], abs=1e-3)  # on the table
    # The root's frame is the model's own.
    assert np.arctan2(last[1, 0], last[0, 0]) == pytest.approx(0.4, abs=1e-3)
    fallen = height - last[2, 3]  # the goal falls with it
    assert result.goal_pose[2, 3] == pytest.approx(0.89 - fallen, abs=1e-5)


def test_its_pose_can_be_tracked(world):
    reaches(before(world(), scheme="model"), 5e-4, 5e-3)


@pytest.mark.parametrize(("changes", "more", "why"), [
    ({"target": {"model": "crat"}}, "", "there is no model 'crat' in world .*did you mean 'crate'"),
    ({"target": {"model": "crate", "link": "bod"}}, "",
     "has no link 'bod' with visuals: did you mean 'body'"),
    ({}, LID, "has 2 links with visuals .body, lid.; name the target's"),
    ({"target": {"model": "ground_plane"}}, "",
     "target: ground_plane::link is not a closed surface"),
    ({"world": ""}, "", "world is not set: set world to the path or name of the file"),
    ({"plant": "free", "world": ""}, "", "only plant bullet has a world"),
    ({"target": {"model": "crate", "shape": "square"}}, "", "has the link's shape"),
])  # fmt: skip
def test_a_link_that_is_not_there_is_named(world, changes, more, why):
    with pytest.raises(ExperimentError, match=why):
        assemble(before(world(0.6205, more)).with_changes(**changes))
