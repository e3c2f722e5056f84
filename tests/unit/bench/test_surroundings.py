"""World files, links as targets, postures in a world; and the parts of an experiment."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_target_files import on_the_arm, seen

from aras_sim_bridge.description import world_file
from aras_sim_bridge.description.world_file import WorldFile
from aras_visual_servo_base.poses import inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment, SunSpec
from aras_visual_servo_bench.experiment.packages import PackagePath
from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
from aras_visual_servo_bench.experiment.robots import Robot
from aras_visual_servo_bench.experiment.worlds import (
    find_world_link,
    find_world_path,
    read_surroundings,
    read_world,
    with_target_link,
)
from aras_visual_servo_bench.setup.assembly import assemble, check
from aras_visual_servo_bench.setup.posture_search import PostureSearch
from aras_visual_servo_bench.targets.solids import read_solid_target
from aras_visual_servo_bench.targets.target_spec import TargetSpec
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.schemes import JointController

PACKAGES = PackagePath()
BOX = "<geometry><box><size>{}</size></box></geometry>"
WORLD = f"""<sdf version="1.6"><world name="a">
<light name="lamp" type="point"><pose>0 0 3 0 0 0</pose><diffuse>1 1 1 1</diffuse></light>
<model name="crate"><static>1</static><pose>0.02 0.01 0.6 0 0 0.4</pose>
  <link name="body">
    <visual name="v"><pose>0 0 0.05 0 0 0</pose>{BOX.format("0.08 0.05 0.06")}</visual></link>
  <link name="hid"><collision name="c">{BOX.format("1 1 1")}</collision></link></model>
<model name="pair"><static>1</static>
  <link name="a"><visual name="v">{BOX.format("1 1 1")}</visual></link>
  <link name="b"><visual name="v">{BOX.format("1 1 1")}</visual></link></model>
<model name="bare"><static>1</static><link name="c"/></model></world></sdf>"""


@pytest.fixture
def world(tmp_path):
    (tmp_path / "a.world").write_text(WORLD)
    return str(tmp_path / "a.world")


def test_without_a_world_the_sun_is_as_it_is_asked_for():
    sun = SunSpec(direction=(0.1, 0.2, -1.0), diffuse=0.3, shines=((0.0005, 0.4), (1.0, 2.0)))
    found = read_surroundings(Experiment(sun=sun), PACKAGES)
    assert found.ground_plane and not found.models
    (light,) = found.lights
    assert (light.direction, light.diffuse, light.lit_intervals) == (
        (0.1, 0.2, -1.0), (0.3, 0.3, 0.3, 1.0), sun.shines)
    for shines, kept in ((None, None), (((0.0005, 0.001),), None), (((0.001, 0.4),), ()),
                         (((0.0, 0.0009),), ())):  # at 1 ms
        asked = Experiment(sun=replace(sun, shines=shines))
        assert read_surroundings(asked, PACKAGES, is_teaching=True).lights[0].lit_intervals == kept


def test_a_world_is_read_by_its_name_or_path(world, monkeypatch, tmp_path):
    shipped = f"{PACKAGES.find('aras_visual_servo_gazebo')}/world/workbench.world"
    assert find_world_path(Experiment(world="workbench"), PACKAGES) == shipped
    assert find_world_path(Experiment(), PACKAGES) == "" and read_world("", PACKAGES) == WorldFile()
    monkeypatch.chdir(tmp_path)
    for given in ("a.world", "./a.world", world):
        found = read_surroundings(Experiment(world=given), PACKAGES)
        assert [model.name for model in found.models] == ["crate", "pair", "bare"]
        assert found.lights[0].name == "lamp"
    (tmp_path / "b").write_text("<no")
    with pytest.raises(ExperimentError, match="b"):
        read_world(str(tmp_path / "b"), PACKAGES)
    with pytest.raises(ExperimentError, match="did you mean 'workbench.world'"):
        find_world_path(Experiment(world="workbemch"), PACKAGES)


def test_a_link_of_a_world_is_a_solid_at_its_place(world):
    path, pose, link = find_world_link(world, PACKAGES, "crate", "")
    assert link == "body"
    np.testing.assert_allclose(pose, [0.02, 0.01, 0.6, 0.0, 0.0, 0.4], atol=1e-9)
    corners = read_solid_target(Path(path)).solid.vertices
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)],
                               [(-0.04, -0.025, 0.02), (0.04, 0.025, 0.08)], atol=1e-9)
    for name, wanted, why in (
            ("crat", "", f"there is no model 'crat' in world '{world}': did you mean 'crate'"),
            ("crate", "hid", "model 'crate' has no link 'hid' with visuals: "),
            ("pair", "", "model 'pair' has 2 links with visuals .a, b.; name the target's link"),
            ("bare", "", "model 'bare' has 0 links with visuals .none.; name the target's link")):
        with pytest.raises(ExperimentError, match=why):
            find_world_link(world, PACKAGES, name, wanted)
    made = with_target_link(Experiment(world=world, target={"model": "crate"}), PACKAGES).target
    assert (made.link, made.model, made.shape) == ("body", "crate", path)
    np.testing.assert_allclose(made.pose, pose)


ARM = """<robot name="r"><link name="world"/>
<link name="post"><visual><origin xyz="0 0 0.1"/><geometry><box size="0.1 0.2 0.3"/></geometry>
</visual></link><joint name="p" type="fixed"><parent link="world"/><child link="post"/>
<origin xyz="1 2 3" rpy="0 0 0.5"/></joint>
<link name="tool"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="world"/><child link="tool"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""


def test_a_link_of_the_robot_s_that_stands_is_one_too(tmp_path):
    (tmp_path / "r.urdf").write_text(ARM)

    def asked(link):
        robot = {"urdf": str(tmp_path / "r.urdf")}
        return with_target_link(Experiment(robot=robot, target={"link": link}), PACKAGES).target

    found = asked("post")
    np.testing.assert_allclose(found.pose, [1, 2, 3, 0, 0, 0.5], atol=1e-9)
    corners = read_solid_target(Path(found.shape)).solid.vertices
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)],
                               [(-0.05, -0.1, -0.05), (0.05, 0.1, 0.25)], atol=1e-9)
    for link, why in (("tool", "^target.link: a joint of the robot moves 'tool'; for a target "),
                      ("pst", "^target.link: model 'r' has no link 'pst' with visuals: did")):
        with pytest.raises(ExperimentError, match=why):
            asked(link)
    (tmp_path / "r.urdf").write_text(ARM.replace('type="revolute"', 'type="none"'))
    with pytest.raises(ExperimentError, match="^target.link: "):
        asked("post")


class Told(PostureSearch):
    def compute_occlusion(self, joints, time=0.0):
        return 0.37

    def find_collision(self, joints):
        return "link 'a' of the arm is in 'b'"


def told(is_visible):
    spec = TargetSpec("square", (0.1, 0.05), (0.0, 0.0, 0.6, 0.0, 0.0, 0.0))
    return Told("urdf", ("search",), "eye", "", spec, is_visible=is_visible, near=0.02)


def test_what_speaks_against_a_posture_is_said_and_weighed():
    joints = (0.1, 0.2)
    assert told(True).compute_cost(joints) == 2.37 and told(False).compute_cost(joints) == 2.0
    assert told(True).list_faults(joints, "goal", True) == [
        "the arm is in collision at the goal (link 'a' of the arm is in 'b'); give other joints",
        "the arm hides 37 % of the target at the goal; give other joints"]
    (fault,) = told(False).list_faults(joints, "start", False)
    assert fault == (
        "the arm is in collision at the start (link 'a' of the arm is in 'b'), and no posture "
        "without a collision was found; give another pose")
    assert told(True).list_faults(joints, "start", False)[1] == (
        "the arm hides 37 % of the target at the start, and no posture that hides less was found; "
        "give another pose")


EYE = {"width": 320, "height": 240, "horizontal_fov": 1.2}
BASE = {"plant": "free", "features": "exact", "scheme": "points", "camera": EYE,
        "target": {"shape": "l_shape", "size": [0.06, 0.05], "pose": [0, 0, 0.59, 0, 0, 0.2]},
        "goal": {"pose": [0.01, 0.0, 0.85, np.pi, 0.05, 0.0]},
        "start": {"pose": [0.03, 0.0, 0.9, np.pi, 0.0, 0.2]}}  # fmt: skip
ABOVE = matrix_from_xyz_rpy((0.01, 0.0, 0.85), (np.pi, 0.05, 0.0))


def parts(**keys):
    wrap = {k: keys.pop(k) for k in ("wrap_scheme", "has_unread_cameras", "has_depth") if k in keys}
    return assemble(Experiment.from_mapping({**BASE, **keys}), **wrap)


TWO = {"camera": "original", "scheme": "points@left+points@right", "cameras": {
    "left": {"model": EYE}, "other": {"model": EYE},
    "right": {"model": EYE, "xyz": [0.0, -0.02, 0.0], "delay": 0.03,
              "calibration_offset": {"depth": 2.0}}}}  # fmt: skip


def test_the_cameras_that_watch_are_there_where_they_are_wanted():
    assert list(parts(**TWO).cameras) == ["left", "right", "other"]  # read ones first
    found = parts(**TWO, has_unread_cameras=False)
    assert list(found.cameras) == ["left", "right"] == list(found.rig.observers)
    assert list(found.placements) == ["right"] and found.postures is None
    assert found.calibrated_camera is found.cameras["left"].calibrated_camera
    assert found.needs == found.rig.control.needs
    assert parts(has_depth=True).plant.imaging.has_depth and not parts().plant.imaging.has_depth
    wrapped = []
    found = parts(wrap_scheme=lambda scheme: wrapped.append(scheme) or scheme)
    assert wrapped == [found.servo.scheme]


def test_each_camera_s_depth_is_as_it_is_believed():
    found, plain = parts(**TWO), parts(**{**TWO, "cameras": {
        **TWO["cameras"], "right": {"model": EYE, "xyz": [0.0, -0.02, 0.0]}}})
    assert found.goal.depth == plain.goal.depth
    np.testing.assert_allclose(found.goal.plane, plain.goal.plane)
    deep, true = found.goal.other_cameras["right"], plain.goal.other_cameras["right"]
    np.testing.assert_allclose(deep.plane, np.array(true.plane) / 2.0)
    believed = parts(calibration_offset={"depth": 1.5, "xyz": [0.01, 0, 0]})
    off = ABOVE @ matrix_from_xyz_rpy((0.01, 0, 0), (0, 0, 0))
    np.testing.assert_allclose(believed.goal.world_T_camera, off, atol=1e-12)
    shape, at = believed.target.shape, believed.target.target_T_camera(off)
    assert believed.goal.depth == pytest.approx(1.5 * shape.depth(at))
    np.testing.assert_allclose(believed.goal.plane, np.array(shape.plane(at)) / 1.5, atol=1e-12)
    assert believed.goal.name == "goal" and believed.goal.joints == {}
    np.testing.assert_allclose(believed.goal_pose, ABOVE, atol=1e-12)


def test_a_flying_camera_begins_at_its_start_about_the_goal():
    found = parts()
    start = matrix_from_xyz_rpy((0.03, 0, 0.9), (np.pi, 0, 0.2))
    np.testing.assert_allclose(found.plant.read_rest_pose(), start, atol=1e-9)
    np.testing.assert_allclose(found.servo.arm.pose(np.zeros(6)), ABOVE, atol=1e-12)
    robot = Robot(RobotSpec()).make_arm()
    q = np.array([0.05, 0.0, -0.09, 0.045, 0.045, 0.1])
    shown = parts(goal=q.tolist(), target={}, start=q.tolist())
    np.testing.assert_allclose(shown.plant.read_rest_pose(), robot.pose(q), atol=1e-9)
    np.testing.assert_allclose(shown.goal_pose, robot.pose(q), atol=1e-12)
    named = parts(goal="2016", scheme="moments", target={}, start="2016")
    assert "2016" in named.goal.name
    assert named.goal.joints == {} and named.goal.moments is not None
    assert named.goal.target is not None  # it was worked out, and not shown
    solid = {"shape": "box", "size": [0.05, 0.04, 0.03], "pose": [0.01, 0.0, 0.605, 0, 0, 0.3]}
    shown = parts(goal="2016", scheme="moments", target=solid, start="2016")
    assert shown.goal.target is None and shown.goal.moments.m00 != named.goal.moments.m00


def test_another_camera_s_goal_is_where_the_camera_is_believed_and_in_its_view():
    q = [0.05, 0.0, -0.09, 0.045, 0.045, 0.1]
    off = {"xyz": [0.002, 0.0, 0.001], "rpy": [0.01, 0.02, 0.03]}
    eyes = {"left": {"model": EYE},
            "right": {"model": EYE, "xyz": [0.0, -0.02, 0.0], "calibration_offset": off}}
    asked = {**TWO, "plant": "chain", "target": {}, "goal": q, "start": q, "cameras": eyes}
    found = parts(**asked)
    robot = Robot(RobotSpec(), cameras=Experiment.from_mapping({**BASE, **asked}).cameras)
    wrong = robot.make_camera_kinematics("right", robot.make_arm("left"), is_calibrated=True)
    goal = found.goal.other_cameras["right"].world_T_camera
    np.testing.assert_allclose(goal, wrong.pose(np.array(q)), atol=1e-9)
    assert np.abs(goal - robot.make_arm("right").pose(np.array(q))).max() > 1e-3
    asked |= {"goal": "2016", "start": "2016", "scheme": "moments@left+area@right"}
    assert parts(**asked).goal.other_cameras["right"].moments is not None
    eyes["right"]["rpy"] = [0.0, 0.0, 1.0]
    with pytest.raises(ExperimentError, match="but not of camera 'right'"):
        parts(**asked)


class Joints(JointController):
    names, tolerances = ("x",), (1.0,)

    def process_image(self, observation, goal, t): ...
    def update(self, t, dt, joints): ...


@pytest.mark.parametrize(("keys", "why"), [
    ({"plant": "ideal", "scheme": f"{__name__}:Joints"}, "commands joints, but the ideal camera"),
    ({"scheme": "luminance"}, "needs images: set features to images"),
    ({"features": "images", "scheme": "moments", "controller_parameters": {"segmentation": {
        "method": "colour", "colour_low": [0, 0, 0], "colour_high": [9, 9, 9]}}},
     "segmentation 'colour' needs colours, but the images of plant 'free' are grey"),
    ({"target": {"shape": "circle"}}, "target 'circle' has no corners, which scheme 'points' n"),
    ({"start": "none"}, "start is 'none', but a plant needs a start"),
    ({"goal": [0.0] * 5, "target": {}}, "goal is .0.0, 0.0"),
    ({"goal": [9.0, 0, 0, 0, 0, 0], "target": {}}, "goal puts joint gantry at 9.0000"),
    ({"start": [9.0, 0, 0, 0, 0, 0]}, "start puts joint gantry at 9.0000"),
    ({"goal": {"pose": [0.0, 0.0, 0.85, 0.0, 0.0, 0.0]}}, "goal: the target is behind the camera")])
def test_what_cannot_be_is_said_before_a_world_is_made(keys, why):
    experiment = Experiment.from_mapping({**BASE, **keys})
    for found in (check, assemble):
        with pytest.raises(ExperimentError, match=why):
            found(experiment)


def test_the_ideal_camera_s_plane_counts_as_measured():
    found = parts(plant="ideal")
    joints = found.servo.arm.read_joints(
        found.plant.joint_names, np.array([0.02, 0, 0.01, 0.1, 0, 0.3]))
    pixels = np.array([[150.0, 90.0], [210.0, 95.0], [205.0, 140.0]])
    reading = Frame(40_000_000, outline=pixels, points=pixels, camera=found.plant.camera)
    plane = found.observe(reading, joints).plane
    there = found.servo.arm.pose(joints.positions)
    point = np.array([0.1, -0.2, 1.0]) / (np.array(found.goal.plane) @ (0.1, -0.2, 1.0))
    here = (inverse(there) @ found.goal_pose @ (*point, 1.0))[:3]
    assert np.dot(plane, here) == pytest.approx(1.0)


GAZEBO = Path(__file__).resolve().parents[3] / "src" / "aras_visual_servo_gazebo"
SMALL = {"width": 160, "height": 120, "horizontal_fov": 1.2}
STILL = {"friction": False, "duration": 0.2, "camera": SMALL}


def test_the_workbench_is_seen_all_around_the_target():
    world = world_file.load_world(str(GAZEBO / "world" / "workbench.world"), lambda _: str(GAZEBO))
    assert world.warnings == ()
    assert (len(world.lights), world.scene.shadows, world.scene.sky) == (3, "hard", True)
    table, *_ = seen(on_the_arm("l_shape", **STILL))
    bench, *_ = seen(on_the_arm("l_shape", world="workbench", **STILL))
    # The table is one grey; the bench has grain nearly everywhere.
    flat = [float((cv2.Laplacian(one.astype(float), cv2.CV_64F) == 0).mean())
            for one in (table, bench)]
    assert flat[0] > 0.8 and flat[1] < 0.3
    assert len(np.unique(bench)) > 60
