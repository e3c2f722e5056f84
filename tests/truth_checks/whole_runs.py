"""Complete experiments, compared with an independent loop.

MuJoCo simulates the arm; this module implements image, interaction matrix and control law.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.runner.loop import run

from .check import Row, check
from .robots import bare_urdf

TABLE = 0.591  # height of the targets of the arm, m
LINK = "camera_link"  # looks along x, with z up
SCHEMES = ("points", "numbered_points", "segments", "lines", "polar_points", "points_3d", "pose",
           "two_and_half_d")  # fmt: skip
COUNT = 24
# Time step, s; gain, 1/s; largest number of steps; normalised error at which the loop stops.
STEP, GAIN, STEPS, MIN_ERROR = 0.02, 2.0, 4000, 1e-12


class MujocoArm:
    def __init__(self, names: tuple[str, ...]) -> None:
        compiler = '<mujoco><compiler discardvisual="true" fusestatic="false" boundmass="1e-6" ' \
                   'boundinertia="1e-9"/></mujoco>'
        text = re.sub(r"(<robot[^>]*>)", rf"\1{compiler}", bare_urdf("shipped arm"), count=1)
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        self._link = self._model.body(LINK).id
        joints = [self._model.joint(name).id for name in names]
        self._q = [self._model.jnt_qposadr[j] for j in joints]
        self._v = [self._model.jnt_dofadr[j] for j in joints]

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Return world_T_camera (4, 4) of the optical frame at joint positions (n,)."""
        self._data.qpos[self._q] = q
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        axes = self._data.xmat[self._link].reshape(3, 3)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([-axes[:, 1], -axes[:, 2], axes[:, 0]])
        pose[:3, 3] = self._data.xpos[self._link]
        return pose

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the Jacobian (6, n) of the camera twist in its optical frame."""
        turn = self.pose(q)[:3, :3].T
        moves, turns = np.zeros((2, 3, self._model.nv))
        mujoco.mj_jacBody(self._model, self._data, moves, turns, self._link)
        return np.vstack([turn @ moves, turn @ turns])[:, self._v]


def _pose(six: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", six[3:]).as_matrix()
    pose[:3, 3] = six[:3]
    return pose


def _image(corners: np.ndarray, world_T_camera: np.ndarray) -> np.ndarray:
    """Return normalised coordinates and depths (n, 3) of points (n, 3) in the world."""
    X, Y, Z = np.linalg.solve(world_T_camera, np.column_stack([corners, np.ones(len(corners))]).T)[
        :3
    ]
    return np.column_stack([X / Z, Y / Z, Z])


def _twist(seen: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Compute the camera twist (6,) with which the error of the points decays exponentially."""
    x, y, Z = seen.T
    zero = np.zeros(len(x))
    L = np.vstack([
        np.column_stack([-1 / Z, zero, x / Z, x * y, -1 - x * x, y]),
        np.column_stack([zero, -1 / Z, y / Z, 1 + y * y, -x * y, -x]),
    ])  # fmt: skip
    return -GAIN * np.linalg.pinv(L) @ (seen - desired)[:, :2].T.ravel()


def _servo(
    corners: np.ndarray, goal: np.ndarray, pose: np.ndarray,
    move: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return the final world_T_camera (4, 4) of a servo loop that starts at a pose."""
    desired = _image(corners, goal)
    for _ in range(STEPS):
        seen = _image(corners, pose)
        if np.abs(seen - desired)[:, :2].max() < MIN_ERROR:
            break
        pose = move(STEP * _twist(seen, desired))
    return pose


def _make_free_motion(pose: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def move(displacement: np.ndarray) -> np.ndarray:
        nonlocal pose
        a, b, c = displacement[3:]
        generator = np.zeros((4, 4))
        generator[:3, :3] = [[0, -c, b], [c, 0, -a], [-b, a, 0]]
        generator[:3, 3] = displacement[:3]
        pose = pose @ expm(generator)
        return pose

    return move


def _make_arm_motion(arm: MujocoArm, q: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def move(displacement: np.ndarray) -> np.ndarray:
        nonlocal q
        q = q + np.linalg.solve(arm.jacobian(q), displacement)
        return arm.pose(q)

    return move


def _keys(number: int) -> dict[str, Any]:
    """Return the keys of an experiment; odd numbers use the arm, every eighth uses images."""
    random = np.random.default_rng([number, 2])
    flies = number % 2 == 0
    lean = float(np.radians(random.uniform(9.0, 15.0)) * random.choice([-1.0, 1.0]))
    height = float(random.uniform(0.25, 0.3))
    x, y = random.uniform(-0.01, 0.01, 2).tolist()
    size = float(random.uniform(0.09, 0.12))
    shape = np.array([[-0.5, -0.4], [0.5, -0.5], [0.4, 0.5], [-0.3, 0.3]])
    shape = size * (shape + random.uniform(-0.08, 0.08, (4, 2)))
    goal = [x, y - height * np.tan(lean), TABLE + height, np.pi + lean, 0.0, 0.0]
    start = np.array(goal) + [*random.uniform(-0.03, 0.03, 3), *random.uniform(-0.12, 0.12, 3)]
    return {
        "plant": "free" if flies else "chain", "scheme": SCHEMES[number % len(SCHEMES)],
        "features": "images" if number % 8 > 5 else "exact",
        "target": {"shape": shape.tolist(),
                   "pose": [*random.uniform(-0.02, 0.02, 2).tolist(), TABLE, 0.0, 0.0,
                            float(random.uniform(-0.5, 0.5))]},
        "goal": {"pose": goal}, "start": {"pose": start.tolist()}, "seed": number,
        "gain": float(random.uniform(1.5, 3.0)), "duration": 14.0, "time_after_convergence": 1.0,
    }  # fmt: skip


def _repeated(keys: dict[str, Any]) -> tuple[Run, np.ndarray, float]:
    """Return a run, the final pose of the independent loop, and the largest position error, m."""
    found = run(Experiment.from_mapping(keys))
    flat = np.column_stack([keys["target"]["shape"], np.zeros(4), np.ones(4)])
    corners = (flat @ _pose(keys["target"]["pose"]).T)[:, :3]
    goal, start, away = _pose(keys["goal"]["pose"]), found.true_pose[0], 0.0
    if keys["plant"] == "free":
        move = _make_free_motion(start)
    else:
        arm = MujocoArm(found.joint_names)
        move = _make_arm_motion(arm, found.measured_positions[0])
        start = arm.pose(found.measured_positions[0])
        away = max(float(np.abs(arm.pose(q) - T).max())
                   for q, T in zip(found.measured_positions, found.true_pose,
                       strict=True))  # fmt: skip
    return found, _servo(corners, goal, start, move), away


def _rows(numbers: range) -> Iterator[Row]:
    away = 0.0
    for number in numbers:
        keys = _keys(number)
        found, pose, off = _repeated(keys)
        away = max(away, off)
        left = found.states[-1].arrival_status.pose_uncertainty
        bounds = (np.nan, np.nan) if left is None else (left.distance, left.angle)
        end = found.true_pose[-1]
        turn = Rotation.from_matrix(pose[:3, :3].T @ end[:3, :3]).magnitude()
        parts = np.linalg.norm(pose[:3, 3] - end[:3, 3]) / bounds[0], turn / bounds[1]
        what = f"{keys['plant']}, {keys['scheme']}, {keys['features']}: {found.outcome}"
        yield Row(what, "the same final pose", float(np.max(parts)), 1.0, "of the uncertainty")
    yield Row(f"camera pose at the measured joints, {len(numbers)} runs", "equal", 1e3 * away, 1e-6,
              "mm")  # fmt: skip


@check("MuJoCo and an independent loop", quick=True)
def complete_runs_short() -> Iterator[Row]:
    """Compare the final poses of three experiments with those of an independent loop."""
    yield from _rows(range(5, 8))


@check("MuJoCo and an independent loop")
def complete_runs() -> Iterator[Row]:
    """Compare the final poses of experiments with a free camera and with the arm."""
    yield from _rows(range(COUNT))
