"""Equations of motion at random states, compared with Pinocchio and MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pinocchio

from aras_sim_bridge.world import Pose, Twist

from .check import Row, check
from .robots import ARMS, Robot

_STATES = 5


def _worst(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the largest difference divided by the largest component."""
    return float(np.abs(np.subtract(ours, theirs)).max() / np.abs(theirs).max())


Sample = Callable[[Robot, np.random.Generator], tuple[np.ndarray, dict[str, np.ndarray]]]


def _compared(seed: int, sample: Sample, bound: float) -> Iterator[Row]:
    """Yield the worst differences of each arm at random states, by the software compared with."""
    rng = np.random.default_rng(seed)
    for name in ARMS:
        worst: dict[str, float] = {}
        with Robot(name) as robot:
            for _ in range(_STATES):
                ours, theirs = sample(robot, rng)
                for other, value in theirs.items():
                    worst[other] = max(worst.get(other, 0.0), _worst(ours, value))
        for other, value in worst.items():
            yield Row(f"{name}, {other}" if len(worst) > 1 else name, "equal", value, bound)


@check("Pinocchio, MuJoCo", quick=True)
def mass_matrix() -> Iterator[Row]:
    """Compare the mass matrix, measured by unit efforts on a robot at rest."""
    def sample(robot: Robot, rng: np.random.Generator) -> tuple:
        n = len(robot.names)
        q, columns = rng.uniform(-1.2, 1.2, n), []
        for effort in (np.zeros(n), *np.eye(n)):
            robot.set_state(q, np.zeros(n))
            columns.append(robot.step(effort))
        ours = np.linalg.inv(np.stack(columns[1:], axis=1) - columns[0][:, None])
        half = pinocchio.crba(robot.pin, robot.data, robot.pin_state(q))
        theirs = np.triu(half) + np.triu(half, 1).T
        robot.mj_data.qpos[robot.mj_q] = q
        mujoco.mj_forward(robot.mj, robot.mj_data)
        full = np.zeros((robot.mj.nv, robot.mj.nv))
        mujoco.mj_fullM(robot.mj, robot.mj_data, full)
        return ours, {"Pinocchio": theirs[np.ix_(robot.pin_v, robot.pin_v)],
                      "MuJoCo": full[np.ix_(robot.mj_v, robot.mj_v)]}  # fmt: skip

    yield from _compared(1, sample, 1e-6)


@check("Pinocchio", quick=True)
def gravity_and_velocity_terms() -> Iterator[Row]:
    """Compare the efforts that keep joint velocities constant."""
    def sample(robot: Robot, rng: np.random.Generator) -> tuple:
        n = len(robot.names)
        q, v = rng.uniform(-1.2, 1.2, n), rng.uniform(-3.0, 3.0, n)
        robot.set_state(q, v)
        theirs = pinocchio.nonLinearEffects(robot.pin, robot.data, robot.pin_state(q),
                                            robot.pin_vector(v))  # fmt: skip
        return robot.model.bias_efforts(), {"Pinocchio": theirs[robot.pin_v]}

    yield from _compared(2, sample, 1e-9)


@check("Pinocchio, MuJoCo", quick=True)
def accelerations() -> Iterator[Row]:
    """Compare joint accelerations at random positions, velocities and efforts."""
    def sample(robot: Robot, rng: np.random.Generator) -> tuple:
        n = len(robot.names)
        q, v = rng.uniform(-1.2, 1.2, n), rng.uniform(-3.0, 3.0, n)
        effort = rng.uniform(-20.0, 20.0, n)
        robot.set_state(q, v)
        ours = robot.step(effort)
        theirs = pinocchio.aba(robot.pin, robot.data, robot.pin_state(q), robot.pin_vector(v),
                               robot.pin_vector(effort))  # fmt: skip
        data = robot.mj_data
        data.qpos[robot.mj_q], data.qvel[robot.mj_v] = q, v
        data.qfrc_applied[robot.mj_v] = effort
        mujoco.mj_forward(robot.mj, data)
        return ours, {"Pinocchio": theirs[robot.pin_v], "MuJoCo": data.qacc[robot.mj_v]}

    yield from _compared(3, sample, 1e-6)


@check("Pinocchio, MuJoCo", quick=True)
def a_free_base() -> Iterator[Row]:
    """Compare the accelerations of a tumbling base of 5 kg and of its three joints."""
    rng = np.random.default_rng(4)
    worst = dict.fromkeys(("base, Pinocchio", "joints, Pinocchio", "base, MuJoCo",
                           "joints, MuJoCo"), 0.0)  # fmt: skip
    step = 1e-6  # s; small enough that the finite difference equals the derivative
    with Robot("free arm", step) as robot:
        n = len(robot.names)
        for _ in range(_STATES):
            q, v = rng.uniform(-1.0, 1.0, n), rng.uniform(-2.0, 2.0, n)
            effort = rng.uniform(-3.0, 3.0, n)
            pose = Pose.from_rpy(tuple(rng.uniform(-1, 1, 3)), tuple(rng.uniform(-1, 1, 3)))
            linear, angular = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)
            robot.model.set_pose(pose)
            robot.model.set_twist(Twist(tuple(linear), tuple(angular)))
            robot.set_state(q, v)
            before = robot.model.twist()
            joints = robot.step(effort)
            base = (np.ravel(robot.model.twist()) - np.ravel(before)) / step
            for other, accelerate in (("Pinocchio", _pinocchio_free), ("MuJoCo", _mujoco_free)):
                theirs = accelerate(robot, pose, linear, angular, q, v, effort)
                for what, ours, their in zip(("base", "joints"), (base, joints), theirs,
                                             strict=True):  # fmt: skip
                    key = f"{what}, {other}"
                    worst[key] = max(worst[key], _worst(ours, their))
    for what, value in worst.items():
        yield Row(what, "equal", value, 1e-4)


def _pinocchio_free(robot: Robot, pose: Pose, linear: np.ndarray, angular: np.ndarray,
                    q: np.ndarray, v: np.ndarray, effort: np.ndarray
                    ) -> tuple[np.ndarray, np.ndarray]:
    turn = pose.matrix()[:3, :3]
    velocity = robot.pin_vector(v)
    velocity[:3], velocity[3:6] = turn.T @ linear, turn.T @ angular
    found = pinocchio.aba(robot.pin, robot.data, robot.pin_state(q, pose), velocity,
                          robot.pin_vector(effort))
    # Pinocchio returns the spatial acceleration in the frame of the body.
    straight = turn @ (found[:3] + np.cross(velocity[3:6], velocity[:3]))
    return np.concatenate([straight, turn @ found[3:6]]), found[robot.pin_v]


def _mujoco_free(robot: Robot, pose: Pose, linear: np.ndarray, angular: np.ndarray,
                 q: np.ndarray, v: np.ndarray, effort: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
    data, turn = robot.mj_data, pose.matrix()[:3, :3]
    data.qpos[:7] = [*pose.xyz, pose.quat[3], *pose.quat[:3]]
    data.qvel[:6] = [*linear, *(turn.T @ angular)]
    data.qpos[robot.mj_q], data.qvel[robot.mj_v] = q, v
    data.qfrc_applied[robot.mj_v] = effort
    mujoco.mj_forward(robot.mj, data)
    # Free joint of MuJoCo: linear part in world axes, angular part in body axes.
    return np.concatenate([data.qacc[:3], turn @ data.qacc[3:6]]), data.qacc[robot.mj_v].copy()
