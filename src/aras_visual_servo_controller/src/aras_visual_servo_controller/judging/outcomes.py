"""What a run came to: a word, the reason, and the one piece of advice that belongs to the word."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

CALIBRATE = "calibrate the camera: K, D, and where it is mounted; see that it does not shake there"

DO_NOT_FOLLOW = "joints_do_not_follow"

# Advice by kind of outcome; empty: there is nothing to change. {joints} are those it is about.
ADVICE = {
    "running": "",
    "converged": "",
    "stopped": "call start",
    "held": "call start",
    "no_joint_states": "look whether the robot or the simulator runs, and whether its "
    "joint_state_controller is loaded and started",
    DO_NOT_FOLLOW: "look after the controllers of {joints}: whether they run, whether "
    "their gains are too small for the load or so large that the joint swings, and whether "
    "nothing is in the way",
    "too_few_images": "raise the camera's rate, or look after what delays its images",
    "target_lost": "begin nearer to the goal, with the target near the middle of the view; a goal "
    "has to be taught with this camera and scheme",
    "wrong_object": "let the segmentation choose the target: component 'nearest' or 'mask'",
    "target_moves": "let the target stand still, or use a scheme that tells its motion "
    "(Measured.rate)",
    "wrong_camera_model": CALIBRATE,
    "ambiguous": "begin nearer to the goal, or use more features than directions",
    "gain_too_high": "lower the gain, or the delay between image and command; a camera that shakes "
    "so is to be mounted firmly",
    "joint_limit": "begin from another posture, or choose a goal away from the limit",
    "singular": "other features or more of them (at half a turn, which L mean loses: pose, "
    "two_and_half_d or polar_points), another posture, or a goal away from where a direction of "
    "the camera is lost",
    "local_minimum": "begin nearer to the goal, or use L desired or mean; near half a turn pose, "
    "two_and_half_d or polar_points",
    "camera_retreat": "polar_points, two_and_half_d or pose, L mean for less than half a turn, or "
    "a start that is turned less",
    "out_of_reach": "choose a goal nearer to the arm",
    "saturation": "raise max_velocity or max_acceleration, or lower the gain",
    "scheme_fault": "correct the scheme; its traceback is logged",
    "too_noisy": "measure more exactly: a larger target, a shorter distance, more light, or other "
    "features",
    "no_progress": "begin nearer to the goal, or use another scheme or interaction matrix",
    "timed_out": "allow more time, or a higher gain",
}
KINDS = tuple(ADVICE)


@dataclass(frozen=True)
class Outcome:
    """One word for how it stands, the reason in words, and the remedy.

    open_distance, open_angle: of a camera that has arrived, 99.7 % bounds on how far it is from its
    goal, m and rad; inf where it may be anywhere along a direction, NaN where nobody knows.
    """

    kind: str = "running"
    reason: str = ""
    remedy: str = ""
    open_distance: float = nan
    open_angle: float = nan


def outcome(kind: str, reason: str = "", joints: str = "") -> Outcome:
    """The outcome of a kind, with its advice; `joints`: names of those that it is about."""
    return Outcome(kind, reason, ADVICE[kind].format(joints=joints))
