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
    wanted = moved @ matrix_from_xyz_rpy((0.01, 0.02, 0.03), (0, 0, 0))
    np.testing.assert_allclose(lies.compute_pose(0.15).matrix(), wanted, atol=1e-9)
    for time in (0.05, 0.25):
        assert lies.compute_pose(time).xyz == (0.0, 0.0, -1e4)
    still = PlacedTarget(SQUARE, AT)
    assert TargetModel(still, Path("x")).is_static and not lies.is_static
    assert not TargetModel(still, Path("x"), visible_times=((0.0, 1.0),)).is_static
    assert not TargetModel(lies.target, Path("x")).is_static


def test_the_world_and_what_moves_in_it_are_as_asked_wherever_the_arm_stands(
    robot, arm, preset, tmp_path
):  # fmt: skip
    motions = {"moves": RISING, "stands": TargetMotion()}
    shown = [TargetModel(PlacedTarget(SQUARE, AT, motion), write_target(SQUARE, tmp_path, name),
                         name=name) for name, motion in motions.items()]  # fmt: skip
    lamp = Light("lamp", kind="directional", direction=(0, 0, -1.0))
    world = WorldFile(lights=(lamp,), ground_plane=False)
    course = PoseHistory()
    plant = bullet(
        robot, preset, seed=7, renderer="exact", exposure="gazebo", target_models=shown,
        surroundings=world, tracked_link=TargetLink("moves", "moves", course),
    )  # fmt: skip
    config, models = plant.simulation.config, plant.simulation.world.models
    assert (config.renderer, config.seed, config.exposure) == ("exact", 7, "gazebo")
    assert (config.lights, config.scene, config.ground_plane) == (world.lights, world.scene, False)
    assert set(models) == {"robot", "moves", "stands"} and plant.find_collision() is None
    assert plant.outputs == {"position"} and plant.control_camera_name == "camera"

    np.testing.assert_allclose(course.find_pose(0.0), AT, atol=1e-6)
    until(plant, plant.time_ns + 20_000_000)
    time = plant.time_ns * 1e-9
    wanted = AT[2, 3] + time
    assert models["moves"].pose().xyz[2] == pytest.approx(wanted, abs=1e-9)
    assert models["stands"].pose().xyz[2] == pytest.approx(AT[2, 3], abs=1e-6)
    assert course.find_pose(time)[2, 3] == pytest.approx(wanted, abs=1e-6)
    assert course.find_pose(0.5 * time)[2, 3] == pytest.approx(AT[2, 3] + 0.5 * time, abs=1.1e-3)

    q, v = plant.read_joints()
    assert q.shape == v.shape == (6,) and plant.joint_names == arm.names
    by_name = dict(zip(models["robot"].joint_names, models["robot"].read_joints()[0], strict=True))
    np.testing.assert_array_equal(q, [by_name[name] for name in arm.names])
    elsewhere = matrix_from_xyz_rpy((0.2, -0.1, 0.4), (0.3, 0.2, 0.5))
    models["robot"].set_pose(Pose.from_matrix(elsewhere))
    both = np.array([q, q + [0.01, 0.0, 0.1, 0.05, -0.05, 0.3]])
    np.testing.assert_allclose(plant.compute_rest_poses(both),
                               [elsewhere @ arm.pose(one) for one in both], atol=1e-9)
    np.testing.assert_allclose(plant.read_rest_pose(), elsewhere @ arm.pose(q), atol=1e-6)
    origins = arm.joint_origins(both) @ elsewhere[:3, :3].T + elsewhere[:3, 3]
    np.testing.assert_allclose(plant.joint_origins(both), origins, atol=1e-9)
    plant.close()


def test_the_pixels_of_a_label_are_told_and_depth_is_given(robot, preset, tmp_path):
    at = matrix_from_xyz_rpy((0.05, 0.0, 0.62), (0.0, 0.0, 0.4))
    file = write_target(SQUARE, tmp_path, "plate")
    shown = [TargetModel(PlacedTarget(SQUARE, at), file, name="plate")]
    keys, labelled = {"target_models": shown, "labelled_link": "plate"}, {"segmentation": True}
    plant = bullet(robot, preset, camera={**labelled, "depth": True}, **keys)
    with contextlib.closing(plant):
        pose, (reading,), camera = plant.read_pose(), take_frames(plant), plant.camera
    plant.close()
    outline = SQUARE.outline(np.linalg.inv(at) @ pose)
    u, v = np.rint(np.array(camera.project(*outline.mean(axis=0)[:, None])).ravel()).astype(int)
    assert reading.target_mask[v, u] == 255 and set(np.unique(reading.target_mask)) == {0, 255}
    assert reading.target_mask.mean() / 255 < 0.2
    assert reading.depth[v, u] == pytest.approx((np.linalg.inv(pose) @ at)[2, 3], abs=5e-3)
    with contextlib.closing(bullet(robot, preset, **keys)) as bare:  # without label images
        (found,) = take_frames(bare)
    assert found.target_mask is None and found.depth is None
    assert (found.name, found.image.shape, found.encoding) == ("camera", (240, 320, 3), "rgb8")
    with pytest.raises(ExperimentError, match="no link has the label 'plat': did you mean 'plate'"):
        bullet(robot, preset, camera=labelled, **keys | {"labelled_link": "plat"})


def test_an_exposure_at_a_step_s_end_is_seen_then(robot, preset, pinhole):
    sight = ImagingSettings(pinhole, PlacedTarget(SQUARE, AT), rate=20.0, is_unbounded=True)
    with contextlib.closing(bullet(robot, preset, imaging_settings=(sight,))) as plant:
        assert take_frames(plant)[0].stamp_ns == plant.time_ns == 50_000_000


def test_several_cameras_sit_where_the_robot_has_their_frames(preset):
    specs = {"left": CameraSpec(preset), "right": CameraSpec(preset, xyz=(0.0, -0.05, 0.01))}
    robot = Robot(RobotSpec(), cameras=specs)
    others = {"right": {**preset, "update_rate": 20.0}}
    with contextlib.closing(bullet(robot, preset, name="left", other_cameras=others)) as plant:
        assert plant.control_camera_name == "left"
        q = plant.read_joints()[0]
        np.testing.assert_allclose(plant.read_rest_pose(), robot.make_arm("left").pose(q),
                                   atol=1e-6)  # fmt: skip
        link = plant.simulation.world.models["robot"].link_pose("camera_frame_of_right").matrix()
        found = link @ plant.simulation.camera("/right").parent_T_optical
        np.testing.assert_allclose(found, robot.make_arm("right").pose(q), atol=1e-6)
        stamps = {"left": [], "right": []}
        for reading in until(plant, 101_000_000):
            if isinstance(reading, Frame):
                stamps[reading.name].append(reading.stamp_ns)
    assert stamps == {"left": [33_333_333, 66_666_667, 100_000_000],
                      "right": [50_000_000, 100_000_000]}  # fmt: skip
