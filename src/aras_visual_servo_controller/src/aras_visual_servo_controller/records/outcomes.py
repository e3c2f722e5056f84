"""Outcomes of a run with reasons and remedies, and the arrival status."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

from .remedy import Remedy, SettingChange, multiply, remove, set_value

CALIBRATE_CAMERA = Remedy(
    "calibrate the camera (K, D and its mounting) and check that it is mounted firmly",
    remove("calibration_offset"),
)
KEEP_TARGET_AT_REST = Remedy(
    "keep the target at rest, or use a scheme that models its motion "
    "(FeatureMeasurement.error_drift)",
    remove("target.motion"),
)
UNCOVER_TARGET = Remedy(
    "make sure that nothing covers the target and that it does not move",
    remove("target.occluded"), remove("target.occluder"), remove("target.motion"),
)  # fmt: skip
START_CLOSER = multiply("start", 0.5)

JOINTS_DO_NOT_FOLLOW = "joints_do_not_follow"
NO_REMEDY = Remedy()

# Remedy for each kind of outcome; empty if nothing has to be changed. {joints} is replaced by names
# of joints.
REMEDIES = {
    "running": Remedy(),
    "converged": Remedy(),
    "stopped": Remedy("call start"),
    "held": Remedy("call start"),
    "no_joint_states": Remedy(
        "check that the robot or the simulator runs, and that its joint_state_controller is loaded "
        "and started"
    ),
    "unusable_joint_states": Remedy(
        "check the joint states, which node publishes them (rostopic info), and the limits in the "
        "robot description"
    ),
    JOINTS_DO_NOT_FOLLOW: Remedy(
        "check the controllers of {joints}: whether they run, whether their gains are too small "
        "for the load or so large that the joint oscillates, and whether an obstacle blocks it"
    ),
    "too_few_images": Remedy(
        "check that the camera runs, and what delays its images: the load of the machine, the "
        "network, or the camera node"
    ),
    "target_lost": Remedy(
        "start nearer to the goal, with the target near the centre of the image, and teach the "
        "goal with this camera and scheme",
        START_CLOSER,
    ),
    "wrong_object": Remedy(
        "make the segmentation select the target: set component to 'nearest' or 'mask'"
    ),
    "target_moves": KEEP_TARGET_AT_REST,
    "wrong_camera_model": CALIBRATE_CAMERA,
    "ambiguous": Remedy(
        "start nearer to the goal, or use more features than degrees of freedom", START_CLOSER
    ),
    "gain_too_high": Remedy(
        "lower the gain or the delay between image and command; if the camera shakes, mount it "
        "more firmly",
        multiply("gain", 0.3),
    ),
    "joint_limit": Remedy(
        "start from another posture, or choose a goal farther from the joint limit", START_CLOSER
    ),
    "singular": Remedy(
        "use other features, more features, another posture, or a goal farther from the "
        "singularity",
        set_value("scheme", "moments"),
    ),
    "local_minimum": Remedy(
        "start nearer to the goal, or set interaction to desired or mean; for rotations near 180 "
        "degrees use pose, two_and_half_d or polar_points",
        START_CLOSER,
    ),
    "camera_retreat": Remedy(
        "use features that do not make the camera retreat (two_and_half_d, pose), or set "
        "interaction to mean for rotations below 180 degrees",
        set_value("scheme", "polar_points"),
    ),
    "out_of_reach": Remedy("choose a goal within the arm's reach", multiply("goal", 0.5)),
    "saturation": Remedy(
        "allow more time, or raise max_velocity or max_acceleration", multiply("duration", 3.0)
    ),
    "scheme_fault": Remedy(
        "correct the scheme (its traceback is logged), or use a built-in scheme",
        set_value("scheme", "points"),
    ),
    "too_noisy": Remedy(
        "reduce the measurement noise by more light, a shorter distance, other features or a "
        "larger target",
        multiply("target.size", 1.5),
    ),
    "no_progress": Remedy("start nearer to the goal, or use another scheme", START_CLOSER),
    "timed_out": Remedy("allow more time, or raise the gain", multiply("duration", 3.0)),
}
KINDS = tuple(REMEDIES)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run: its kind, the reason as text, and the remedy.

    Attributes:
        open_distance, open_angle: upper bounds of the distance (m) and the angle (rad) between the
            camera and its goal after convergence, with 99.7 % probability; inf if there is no
            bound, NaN if it is unknown.
    """

    kind: str = "running"
    reason: str = ""
    remedy: Remedy = REMEDIES["running"]
    open_distance: float = nan
    open_angle: float = nan

    @property
    def is_open(self) -> bool:
        """Return whether the run is in progress or has converged, without a fault so far."""
        return self.kind == "running" or self.kind.startswith("converged")

    def with_remedy(self, advice: str, *changes: SettingChange) -> Outcome:
        """Return the outcome with another remedy."""
        return replace(self, remedy=Remedy(advice, *changes))


def make_outcome(kind: str, reason: str = "", joints: str = "") -> Outcome:
    """Create the outcome of a kind with its remedy.

    Args:
        kind: one of KINDS.
        reason: reason of the outcome, as text.
        joints: names of the joints that the remedy mentions.
    """
    remedy = REMEDIES[kind]
    return Outcome(kind, reason, Remedy(remedy.format(joints=joints)) if joints else remedy)


@dataclass(frozen=True)
class PoseUncertainty:
    """Uncertainty of the camera's pose relative to the goal after the features have converged.

    Attributes:
        distance, angle: upper bounds of the distance (m) and the angle (rad) between camera and
            goal, with 99.7 % probability; inf if there is no bound, NaN if the scheme has no L.
        description: bounds as text, such as '180° and 0.6 mm' or '1 direction'; empty if they are
            negligible.
        reason: cause of the uncertainty.
        remedy: how to reduce it.
    """

    distance: float = nan
    angle: float = nan
    description: str = ""
    reason: str = ""
    remedy: Remedy = NO_REMEDY


@dataclass(frozen=True)
class ArrivalStatus:
    """Arrival status at one image.

    Attributes:
        is_reached: whether the camera is at its goal.
        pending_reason: why the camera is not at its goal although the features are within their
            tolerances, as text; otherwise empty.
        wrong_pose_reason: why the camera is at another pose although every feature is at its goal,
            as text; otherwise empty.
        pose_uncertainty: uncertainty of the camera's pose relative to the goal; None until the goal
            is reached.
    """

    is_reached: bool = False
    pending_reason: str = ""
    wrong_pose_reason: str = ""
    pose_uncertainty: PoseUncertainty | None = None


NOT_ARRIVED = ArrivalStatus()
