"""Causes of an error that does not decrease, searched for in the latest images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot

import numpy as np

from ..kinematics.elbow import Elbow
from ..records.outcomes import Outcome, make_outcome
from ..records.state import ServoState
from .advice import suggest_larger_target

# A cause of missing progress is reported if at least this fraction of the images shows it.
MIN_IMAGE_PART = 0.6
# A joint limits the motion if its limit reduces all velocities to less than this fraction.
FULL_SPEED = 0.99
# smallest commanded camera speed that is evaluated, in depths of the target per second
MIN_SPEED = 1e-3
# a motion is infeasible if the arm loses more than this part of the desired twist
MAX_LOST_PART = 0.3
# Weight of a rotation in the camera's speed: a rotation at 1 rad/s counts as much as a translation
# at this speed, in target depths per second.
ROTATION_WEIGHT = 0.5
# The camera is in a local minimum if, according to L, no camera motion reduces the error by at
# least this fraction.
MIN_EXPLAINED_PART = 0.1
# An arm is almost straight if the angle of its elbow is less than this, rad.
STRETCHED_BEND = 0.1


@dataclass(eq=False)
class ServoedImage:
    """Data of one image at which the camera was servoed.

    Attributes:
        state: state of the loop at the image.
        error: (k,) error, in units of the tolerances.
        error_size: largest component of the error.
        tolerances: (k,) tolerance of each component of the error.
        depth: depth of the target, m.
        elbows: elbows of the arm.
    """

    state: ServoState
    error: np.ndarray
    error_size: float
    tolerances: np.ndarray
    depth: float
    elbows: Sequence[Elbow] = ()

    # The properties are cached, because each image is evaluated many times.
    @cached_property
    def rank(self) -> int:
        """Return the rank of L."""
        return self.state.rank

    @cached_property
    def full_rank(self) -> int:
        """Return the number of camera directions that the task controls."""
        task = self.state.scheme_output.task
        modelled = 6 if task is None else int(np.count_nonzero(task.modelled))
        return min(modelled, len(self.error))

    @cached_property
    def is_infeasible(self) -> bool:
        """Return whether the arm loses too large a part of the desired camera twist."""
        solution = self.state.ik_solution
        if solution is None:
            return False
        lost = _compute_speed(np.asarray(solution.infeasible_twist), self.depth)
        if lost <= MAX_LOST_PART * MIN_SPEED:
            return False
        desired = _compute_speed(self.state.desired_twist, self.depth)
        return desired >= MIN_SPEED and lost > MAX_LOST_PART * desired

    @cached_property
    def is_stretched(self) -> bool:
        """Return whether an elbow of the arm is almost straight."""
        joints = self.state.joints
        return joints is not None and any(
            abs(joints.positions[elbow.joint] - elbow.straight_position) < STRETCHED_BEND
            for elbow in self.elbows
        )

    @cached_property
    def explained_part(self) -> float:
        """Return the fraction of the error that, according to L, a camera motion can remove."""
        L, norm = self.state.scheme_output.L, float(np.linalg.norm(self.error))
        if L is None or len(L) != len(self.error) or norm == 0.0:
            return 1.0
        L = L * np.repeat((self.depth, 1.0), 3) / self.tolerances[:, None]
        twist = np.linalg.lstsq(L, self.error, rcond=1e-6)[0]
        return float(np.linalg.norm(L @ twist)) / norm


def _compute_speed(twist: np.ndarray, depth: float) -> float:
    """Return the size of a twist (6,), m/s and rad/s, in target depths per second.

    The argument `depth` is in m.
    """
    vx, vy, vz, wx, wy, wz = twist.tolist()
    return hypot(vx, vy, vz) / depth + ROTATION_WEIGHT * hypot(wx, wy, wz)


def find_limit(images: Sequence[ServoedImage]) -> Outcome | None:
    """Return the outcome for joints at their position limits, or None."""
    # List comprehensions are used, because generators would need a call for each image.
    solutions = [image.state.ik_solution for image in images]
    stopped = [one.stopped_joints for one in solutions if one is not None and one.stopped_joints]
    if not images or len(stopped) < MIN_IMAGE_PART * len(images):
        return None
    joints = ", ".join(sorted({name for names in stopped for name in names}))
    return make_outcome(
        "joint_limit", f"the path to the goal leads beyond the limit of {joints}"
    )


def find_rank_loss(images: Sequence[ServoedImage], noise: float) -> Outcome | None:
    """Return the outcome for features that do not measure all camera motions, or None.

    Args:
        images: latest images.
        noise: scatter of the error from image to image, in units of the tolerance.
    """
    count = sum([image.rank < image.full_rank for image in images])
    if not images or count < MIN_IMAGE_PART * len(images):
        return None
    text = f"L has rank {images[-1].rank} of {images[-1].full_rank}"
    if dropped := images[-1].state.dropped_reason:
        return replace(
            make_outcome("too_noisy", f"{text}: {dropped}"), remedy=suggest_larger_target(noise)
        )
    return make_outcome("singular", f"{text}: the features do not measure all camera motions")


def find_minimum(images: Sequence[ServoedImage]) -> Outcome | None:
    """Return the outcome for a local minimum of the error, or None."""
    late = images[len(images) // 2 :]
    if not all([image.explained_part < MIN_EXPLAINED_PART for image in late]):
        return None
    text = ""
    solution = images[-1].state.ik_solution
    if solution is not None and solution.null_direction is not None:
        direction = np.round(np.asarray(solution.null_direction), 2).tolist()
        text = f"; null direction {direction}"
    return make_outcome(
        "local_minimum",
        f"the camera is at rest with an error of {images[-1].error_size:.0f} times its tolerance: "
        "according to L, a camera motion can reduce the error by at most "
        f"{100.0 * images[-1].explained_part:.0f} %{text}",
    )


def find_infeasibility(images: Sequence[ServoedImage]) -> Outcome | None:
    """Return the outcome for an arm that cannot move the camera as desired, or None."""
    count = sum([image.is_infeasible for image in images])
    if not images or count < MIN_IMAGE_PART * len(images):
        return None
    missing = np.round(np.asarray(images[-1].state.ik_solution.infeasible_twist), 4).tolist()
    if sum([image.is_stretched for image in images]) > MIN_IMAGE_PART * len(images):
        return make_outcome(
            "out_of_reach", "the arm is stretched and the goal lies beyond its reach; the arm "
            f"loses this part of the desired twist (m/s, rad/s): {missing}",
        )  # fmt: skip
    return make_outcome(
        "singular", "the arm cannot move the camera as desired; it loses this part of the desired "
        f"twist (m/s, rad/s): {missing}"
    )


def find_saturation(images: Sequence[ServoedImage]) -> Outcome | None:
    """Return the outcome for joints at their speed or acceleration limits, or None."""
    solutions = [image.state.ik_solution for image in images]
    slowed = [one for one in solutions if one is not None and one.scale < FULL_SPEED]
    if not slowed or len(slowed) < MIN_IMAGE_PART * len(images):
        return None
    joint = slowed[-1].limiting_joint
    return make_outcome("saturation", f"{joint} is at its speed or acceleration limit")
