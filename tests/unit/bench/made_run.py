"""A run made so that numbers differ: images at odd times, some lost and some late, one not seen;
joint states that began before; unlike joints; tilted poses; fx other than fy; a target that moves.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from aras_visual_servo_bench import Experiment, Run
from aras_visual_servo_bench.recording.camera_record import CameraRecord
from aras_visual_servo_bench.recording.verdict import Verdict
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget, TargetMotion
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.kinematics.ik_solution import IKSolution
from aras_visual_servo_controller.records.outcomes import ArrivalStatus, PoseUncertainty
from aras_visual_servo_controller.records.state import ServoState
from aras_visual_servo_controller.schemes.base import SchemeOutput

NAMES, UNITS = ("area", "height", "turn"), ("", "m", "rad")
JOINTS, JOINT_UNITS = ("slide", "elbow", "wrist"), ("m", "rad", "rad")
LOWER, UPPER = np.array([-0.1, -2.0, -3.1]), np.array([0.4, 1.5, 2.9])
K = (510.0, 0.0, 297.0, 0.0, 433.0, 222.0, 0.0, 0.0, 1.0)
TWIST = (0.011, -0.006, 0.003, 0.02, -0.01, 0.05)  # of the target
CORNERS = ((-0.031, -0.02), (0.04, -0.022), (0.037, 0.025), (-0.02, 0.03))


def posed(vectors, places):
    found = np.tile(np.eye(4), (len(places), 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    found[:, :3, 3] = places
    return found


GOAL = posed([[2.9, 0.4, 0.3]], [[0.21, -0.13, 0.34]])[0]


def made_run(seed: int, decay: float) -> Run:
    """Make a run that converges; `decay` is the decay rate of its errors, 1/s."""
    rng = np.random.default_rng(seed)
    exposed = 1.537 + np.delete(np.arange(150), [60, 61, 95]) * 0.0341
    exposed = exposed + 1e-4 * rng.random(len(exposed))
    stamp = exposed[11:]
    arrival = exposed + 0.004 + 0.003 * rng.random(len(exposed))
    arrival[[31, 77]] += 0.08
    t = stamp - stamp[0]
    error = np.column_stack([
        0.9 * np.exp(-decay * t), -0.06 * np.exp(-1.3 * decay * t) * np.cos(2.3 * t),
        1.1 * np.exp(-0.8 * decay * t)]) * (1 + 0.01 * rng.normal(size=(len(t), 3)))  # fmt: skip
    desired = np.array([1.3, 0.34, -0.2])
    states = []
    for i, (at, e) in enumerate(zip(stamp, error, strict=True)):
        decision = None if i in (33, 34) else SchemeOutput(
            NAMES, desired + e, np.array(desired), e, filtered_error=0.9 * e)  # fmt: skip
        asked, given = rng.normal(size=(2, 6)) * 0.1 * np.exp(-t[i])
        singular = np.sort(rng.uniform(0.2, 4.0, (2, 3)))[:, ::-1]
        states.append(ServoState(
            float(at), "servoing" if t[i] < 3.0 else "converged", scheme="made",
            scheme_output=decision,
            computation_time=0.002 + 0.001 * rng.random(),
            arrival_status=ArrivalStatus(pose_uncertainty=PoseUncertainty(3.1e-4, 0.0123)),
            ik_solution=IKSolution.from_record(np.zeros(3), asked, given, tuple(singular),
                                            scale=float(rng.uniform(0.4, 1.0))),
        ))  # fmt: skip
    joint_stamp = np.arange(0.9, stamp[-1] + 0.02, 0.0113)
    joint_stamp += 6e-3 * rng.random(len(joint_stamp))
    u = np.maximum(joint_stamp - stamp[0], -0.3)
    farther = (1 + 3 * np.maximum(u, 0.0) * np.exp(-u))[:, None]  # at first
    left = farther * np.exp(-0.9 * decay * u)[:, None]
    places = GOAL[:3, 3] + left * [0.08, -0.05, 0.11] + left * 0.01 * np.column_stack(
        [np.sin(7 * u), np.cos(5 * u), 0 * u])  # fmt: skip
    places += [2.1e-4, 3e-4, -1e-4]
    turned = Rotation.from_matrix(GOAL[:3, :3]) * Rotation.from_rotvec(
        farther * np.exp(-0.7 * decay * u)[:, None] * [0.3, -0.2, 0.5] + [0.004, 0.0, 0.003]
    )
    true_pose = posed(turned.as_rotvec(), places)
    measured = np.column_stack([0.3 * np.exp(-u), -1.0 + 0.4 * np.sin(u), 0.2 * u])
    measured[(u > 1.0) & (u < 1.4), 1] = 1.5 - 1e-3  # at its limit, within a thousandth of 3.5
    measured[(u > 1.3) & (u < 1.7 + 0.1 * decay), 0] = -0.1
    nearest = np.searchsorted(joint_stamp, stamp)
    pace = np.column_stack([np.linspace(stamp[0] - 2.0, stamp[-1], 9), rng.uniform(0.5, 1.5, 9)])
    pace[5, 1] = np.nan
    return Run(
        states=tuple(states), pose=true_pose[nearest], joint_names=JOINTS, joint_stamp=joint_stamp,
        measured_positions=measured,
        measured_velocities=rng.normal(size=measured.shape) * [0.1, 0.7, 1.3],
        joint_commands=measured + 0.01, true_pose=true_pose, goal_pose=GOAL, outcome="converged",
        reason="", remedy="", verdict=Verdict("goal_reached", 4.17e-4, 0.00521), name=f"run {seed}",
        units=UNITS, position_limits=(LOWER, UPPER), speed_limits=np.array([0.3, 1.9, 2.7]),
        joint_units=JOINT_UNITS, real_time_factors=pace,
        cameras={"camera": CameraRecord(CameraModel(640, 400, K), exposed, arrival)},
        target=PlacedTarget(
            PolygonTarget(CORNERS), posed([[0.2, -0.3, 0.4]], [[0.2, -0.1, 0.02]])[0],
            TargetMotion(velocity=TWIST),
        ),
        experiment=Experiment(plant="chain", gain=1.7, delay=0.043),
        settings={"gain": "1.7", "delay": "0.043"},
    )  # fmt: skip


def corners_seen(run):
    """(n, c, 3) of the target's corners in the camera at each image; (n,) its middle's depth."""
    base = run.target.pose
    seen, depth = [], []
    for stamp, pose in zip(run.stamp, run.pose, strict=True):
        turn = Rotation.from_rotvec(np.multiply(TWIST[3:], stamp))
        points = np.array([(x, y, 0.0) for x, y in CORNERS] + [(0.0, 0.0, 0.0)]) @ base[:3, :3].T
        points = turn.apply(points) + base[:3, 3] + np.multiply(TWIST[:3], stamp)
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        seen.append(local[:-1])
        depth.append(local[-1, 2])
    return np.array(seen), np.array(depth)
