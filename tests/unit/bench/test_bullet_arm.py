"""Simulated arm: contents of its world, and measurements."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from frames import take_frames
from test_plants import SQUARE, bullet, until

from aras_sim_bridge.description.types import Light
from aras_sim_bridge.description.world_file import WorldFile
from aras_visual_servo_base.poses import Pose, matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.camera_specs import CameraSpec
from aras_visual_servo_bench.experiment.robot_spec import RobotSpec
from aras_visual_servo_bench.experiment.robots import Robot
from aras_visual_servo_bench.plants.dynamic_arm import TargetLink, TargetModel
from aras_visual_servo_bench.plants.imaging import ImagingSettings
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PoseHistory, TargetMotion
from aras_visual_servo_bench.targets.target_files import write_target
from aras_visual_servo_controller.observation.frame import Frame

AT = matrix_from_xyz_rpy((0.3, 0.1, 0.7), (0.1, 0.2, 0.3))
RISING = TargetMotion(velocity=(0.0, 0.0, 1.0, 0.0, 0.0, 0.5))


def test_a_shown_target_is_where_it_lies_at_its_times():
    lies = TargetModel(PlacedTarget(SQUARE, AT, RISING), Path("x"), (0.01, 0.02, 0.03),
                       ((0.1, 0.2),))
    moved = matrix_from_xyz_rpy((0.3, 0.1, 0.85), (0, 0, 0))
    moved[:3, :3] = matrix_from_xyz_rpy((0, 0, 0), (0, 0, 0.075))[:3, :3] @ AT[:3, :3]
    np.testing.assert_allclose(
        lies.compute_pose(0.15).matrix(),
        moved @ matrix_from_xyz_rpy((0.01, 0.02, 0.03), (0, 0, 0)),
        atol=1e-9,
    )
    for time in (0.05, 0.25):
        assert lies.compute_pose(time).xyz == (0.0, 0.0, -1e4)
    still = PlacedTarget(SQUARE, AT)
    assert TargetModel(still, Path("x")).is_static and not lies.is_static
    assert not TargetModel(still, Path("x"), visible_times=((0.0, 1.0),)).is_static
    assert not TargetModel(lies.target, Path("x")).is_static
    assert (TargetModel(still, Path("x")).name, lies.name) == ("target", "target")


@pytest.fixture(scope="module")
def standing(robot, preset, tmp_path_factory):
    """An arm with a moving and a fixed target, and the contents of its world."""
    folder = tmp_path_factory.mktemp("shown")
    shown = [
        TargetModel(PlacedTarget(SQUARE, AT, motion), write_target(SQUARE, folder, name), name=name)
        for name, motion in (("moves", RISING), ("stands", TargetMotion()))
    ]
    world = WorldFile(lights=(Light("lamp", kind="directional", direction=(0, 0, -1.0)),),
                      ground_plane=False)
    course = PoseHistory()
    plant = bullet(
        robot, preset, seed=7, renderer="exact", exposure="gazebo", target_models=shown,
        surroundings=world, tracked_link=TargetLink("moves", "moves", course),
    )  # fmt: skip
    yield plant, course, world
    plant.close()


def test_the_world_is_made_as_it_is_asked_for(standing):
    plant, _, world = standing
    config = plant.simulation.config
    assert (config.renderer, config.seed, config.exposure) == ("exact", 7, "gazebo")
    assert (config.lights, config.scene, config.ground_plane) == (world.lights, world.scene, False)
    assert set(plant.simulation.world.models) == {"robot", "moves", "stands"}
    assert plant.outputs == {"position"} and plant.control_camera_name == "camera"
    assert plant.peak_speed is None and plant.find_collision() is None


def test_a_target_that_moves_is_where_it_belongs_at_every_step(standing):
    plant, course, _ = standing
    models = plant.simulation.world.models
    np.testing.assert_allclose(course.find_pose(0.0), AT, atol=1e-6)
    until(plant, plant.time_ns + 20_000_000)
    time = plant.time_ns * 1e-9
    wanted = AT[2, 3] + time
    assert models["moves"].pose().xyz[2] == pytest.approx(wanted, abs=1e-9)
    assert models["stands"].pose().xyz[2] == pytest.approx(AT[2, 3], abs=1e-6)
    assert course.find_pose(time)[2, 3] == pytest.approx(wanted, abs=1e-6)
    assert course.find_pose(0.5 * time)[2, 3] == pytest.approx(AT[2, 3] + 0.5 * time, abs=1.1e-3)


def test_it_tells_where_its_joints_and_camera_are_wherever_it_stands(standing, arm):
    """Also of an arm that is put elsewhere as a whole."""
    plant, *_ = standing
    model = plant.simulation.world.models["robot"]
    q, v = plant.read_joints()
    assert q.shape == v.shape == (6,) and plant.joint_names == arm.names
    by_name = dict(zip(model.joint_names, model.read_joints()[0], strict=True))
    np.testing.assert_array_equal(q, [by_name[name] for name in arm.names])
    kept = model.pose()
    elsewhere = matrix_from_xyz_rpy((0.2, -0.1, 0.4), (0.3, 0.2, 0.5))
    model.set_pose(Pose.from_matrix(elsewhere))
    try:
        other = q + [0.01, 0.0, 0.1, 0.05, -0.05, 0.3]
        np.testing.assert_allclose(plant.compute_rest_poses(np.array([q, other])), [
            elsewhere @ arm.pose(q), elsewhere @ arm.pose(other)], atol=1e-9)
        np.testing.assert_allclose(plant.read_rest_pose(), elsewhere @ arm.pose(q), atol=1e-6)
        places = plant.joint_origins(np.array([other, q]))
        assert places.shape[0] == 2
        np.testing.assert_allclose(
            places[1],
            arm.joint_origins(np.array([q]))[0] @ elsewhere[:3, :3].T + elsewhere[:3, 3],
            atol=1e-9,
        )
    finally:
        model.set_pose(kept)


def test_the_first_picture_is_of_the_camera_s_name(standing):
    (found,) = take_frames(standing[0])
    assert found.name == "camera" and found.target_mask is None
    assert found.image.shape == (240, 320, 3) and found.encoding == "rgb8"


def test_the_pixels_of_a_label_are_told_and_depth_is_given(robot, preset, tmp_path):
    at = matrix_from_xyz_rpy((0.05, 0.0, 0.62), (0.0, 0.0, 0.4))
    shown = [
        TargetModel(PlacedTarget(SQUARE, at), write_target(SQUARE, tmp_path, "plate"), name="plate")
    ]
    plant = bullet(robot, preset, camera={"segmentation": True, "depth": True}, target_models=shown,
                   labelled_link="plate")
    with contextlib.closing(plant):
        pose, (reading,), camera = plant.read_pose(), take_frames(plant), plant.camera
    plant.close()
    outline = SQUARE.outline(np.linalg.inv(at) @ pose)
    u, v = np.rint(np.array(camera.project(*outline.mean(axis=0)[:, None])).ravel()).astype(int)
    assert reading.target_mask[v, u] == 255 and set(np.unique(reading.target_mask)) == {0, 255}
    assert reading.target_mask.mean() / 255 < 0.2
    depth = (np.linalg.inv(pose) @ at)[2, 3]
    assert reading.depth[v, u] == pytest.approx(depth, abs=5e-3)
    bare = bullet(robot, preset, target_models=shown, labelled_link="plate")  # without label images
    with contextlib.closing(bare):
        (found,) = take_frames(bare)
    assert found.target_mask is None and found.depth is None
    with pytest.raises(ExperimentError, match="no link has the label 'plat': did you mean 'plate'"):
        bullet(
            robot, preset, camera={"segmentation": True}, target_models=shown, labelled_link="plat"
        )


def test_an_exposure_at_a_step_s_end_is_seen_then(robot, preset, pinhole):
    sight = ImagingSettings(pinhole, PlacedTarget(SQUARE, AT), rate=20.0, is_unbounded=True)
    with contextlib.closing(bullet(robot, preset, imaging_settings=(sight,))) as plant:
        assert take_frames(plant)[0].stamp_ns == plant.time_ns == 50_000_000


def test_several_cameras_sit_where_the_robot_has_their_frames(preset):
    specs = {"left": CameraSpec(preset), "right": CameraSpec(preset, xyz=(0.0, -0.05, 0.01))}
    robot = Robot(RobotSpec(), cameras=specs)
    plant = bullet(
        robot, preset, name="left", other_cameras={"right": {**preset, "update_rate": 20.0}}
    )
    try:
        assert plant.control_camera_name == "left"
        simulation, q = plant.simulation, plant.read_joints()[0]
        np.testing.assert_allclose(
            plant.read_rest_pose(), robot.make_arm("left").pose(q), atol=1e-6
        )
        model = simulation.world.models["robot"]
        seated = simulation.camera("/right")
        link = model.link_pose("camera_frame_of_right").matrix()
        np.testing.assert_allclose(link @ seated.parent_T_optical, robot.make_arm("right").pose(q),
                                   atol=1e-6)
        stamps = {"left": [], "right": []}
        for reading in until(plant, 101_000_000):
            if isinstance(reading, Frame):
                stamps[reading.name].append(reading.stamp_ns)
    finally:
        plant.close()
    assert stamps == {"left": [33_333_333, 66_666_667, 100_000_000],
                      "right": [50_000_000, 100_000_000]}
