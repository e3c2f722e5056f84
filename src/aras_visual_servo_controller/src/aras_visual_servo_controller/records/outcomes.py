"""What a run came to: a word, the reason, and the remedy that belongs to the word; and whether the
camera has arrived, and what that leaves open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

from .remedy import Remedy, multiply, remove, set_value

CALIBRATE_CAMERA = Remedy(
    "calibrate the camera: K, D, and where it is mounted; see that it does not shake there",
    remove("calibration_offset"),
)
KEEP_TARGET_AT_REST = Remedy(
    "keep the target at rest, or use a scheme that knows its motion (FeatureMeasurement.error_drift)",
    remove("target.motion"),
)
UNCOVER_TARGET = Remedy(
    "see that nothing covers the target and that it stays where it is",
    remove("target.occluder"), remove("target.motion"),
)  # fmt: skip
START_CLOSER = multiply("start", 0.5)

JOINTS_DO_NOT_FOLLOW = "joints_do_not_follow"
NO_REMEDY = Remedy()

# Remedy by kind of outcome; empty: there is nothing to change. {joints} are those it is about.
REMEDIES = {
    "running": Remedy(),
    "converged": Remedy(),
    "stopped": Remedy("call start"),
    "held": Remedy("call start"),
    "no_joint_states": Remedy(
        "check that the robot or the simulator runs, and that its joint_state_controller is loaded "
        "and started"
    ),
    JOINTS_DO_NOT_FOLLOW: Remedy(
        "check the controllers of {joints}: whether they run, whether their gains are too small "
        "for the load or so large that the joint swings, and whether nothing is in the way"
    ),
    "too_few_images": Remedy("check that the camera runs, and what delays its images"),
    "target_lost": Remedy(
        "start nearer to the goal, with the target near the middle of the view; the goal has to "
        "be taught with this camera and scheme",
        START_CLOSER,
    ),
    "wrong_object": Remedy("let the segmentation choose the target: component 'nearest' or 'mask'"),
    "target_moves": KEEP_TARGET_AT_REST,
    "wrong_camera_model": CALIBRATE_CAMERA,
    "ambiguous": Remedy(
        "start nearer to the goal, or use more features than directions", START_CLOSER
    ),
    "gain_too_high": Remedy(
        "lower the gain, or the delay between image and command; mount a camera firmly that shakes",
        multiply("gain", 0.3),
    ),
    "joint_limit": Remedy(
        "choose another posture to start from, or a goal away from the limit", START_CLOSER
    ),
    "singular": Remedy(
        "use other features or more of them, another posture, or a goal away from where a "
        "direction of the camera is lost",
        set_value("scheme", "moments"),
    ),
    "local_minimum": Remedy(
        "start nearer to the goal, or use L desired or mean; near half a turn pose, "
        "two_and_half_d or polar_points",
        START_CLOSER,
    ),
    "camera_retreat": Remedy(
        "use features that turn without retreat (two_and_half_d, pose), or L mean for less than "
        "half a turn",
        set_value("scheme", "polar_points"),
    ),
    "out_of_reach": Remedy("choose a goal nearer to the arm", multiply("goal", 0.5)),
    "saturation": Remedy(
        "allow more time, raise max_velocity or max_acceleration", multiply("duration", 3.0)
    ),
    "scheme_fault": Remedy(
        "correct the scheme, its traceback is logged; to see the rest run, use a shipped one",
        set_value("scheme", "points"),
    ),
    "too_noisy": Remedy(
        "measure more exactly: more light, a shorter distance, other features, or a larger target",
        multiply("target.size", 1.5),
    ),
    "no_progress": Remedy("start nearer to the goal, or use another scheme", START_CLOSER),
    "timed_out": Remedy("allow more time, or a higher gain", multiply("duration", 3.0)),
}
KINDS = tuple(REMEDIES)


@dataclass(frozen=True)
class Outcome:
    """One word for the state of the run, the reason as text, and the remedy.

    open_distance, open_angle: of a camera that has arrived, 99.7 % bounds on how far it is from its
    goal, m and rad; inf where it may be anywhere along a direction, NaN where that is not known.
    """

    kind: str = "running"
    reason: str = ""
    remedy: Remedy = REMEDIES["running"]
    open_distance: float = nan
    open_angle: float = nan

    @property
    def is_open(self) -> bool:
        """Whether nothing speaks against the run, so far."""
        return self.kind == "running" or self.kind.startswith("converged")

    def with_remedy(self, advice: str, *changes: object) -> Outcome:
        """The same with another remedy."""
        return replace(self, remedy=Remedy(advice, *changes))


def make_outcome(kind: str, reason: str = "", joints: str = "") -> Outcome:
    """The outcome of a kind, with its remedy; `joints`: names of those that it is about."""
    remedy = REMEDIES[kind]
    return Outcome(kind, reason, Remedy(remedy.format(joints=joints)) if joints else remedy)


@dataclass(frozen=True)
class PoseUncertainty:
    """What an arrival leaves open.

    Attributes:
        distance, angle: 99.7 % bounds on how far the camera is from its goal, m and rad; inf where
            it may be anywhere along a direction, NaN where the scheme has no L to tell them by.
        up_to: the same in words, '180° and 0.6 mm' or '1 direction'; empty where it is next to
            nothing.
        reason, remedy: why, and what would narrow it.
    """

    distance: float = nan
    angle: float = nan
    description: str = ""
    reason: str = ""
    remedy: Remedy = NO_REMEDY


@dataclass(frozen=True)
class ArrivalStatus:
    """What is known of the arrival as of one image.

    Attributes:
        reached: the camera is at its goal.
        short: why it is not, in words, where the features' tolerances alone would do; else empty.
        elsewhere: why the camera is elsewhere although every feature is at its goal, as text; else
            empty.
        open: what the arrival leaves open; None until the goal is reached.
    """

    is_reached: bool = False
    pending_reason: str = ""
    wrong_pose_reason: str = ""
    pose_uncertainty: PoseUncertainty | None = None


NOT_ARRIVED = ArrivalStatus()
