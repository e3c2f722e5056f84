"""A recorded run as plain arrays."""

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_camera.undistortion import CameraModel


@dataclass
class States:
    """What the controller reported, one row an image while it was servoing.

    Attributes:
        stamp: (n,) s.
        phase, reason: n words.
        names: of the k features.
        features, desired, error: (n, k).
        twist: (n, 6) of the camera, optical frame.
        joint_names: j names. commands: (n, j) joint commands.
        singular_values: (n, m), NaN where nothing was inverted.
    """

    stamp: np.ndarray
    phase: list[str]
    reason: list[str]
    names: tuple[str, ...]
    features: np.ndarray
    desired: np.ndarray
    error: np.ndarray
    twist: np.ndarray
    joint_names: tuple[str, ...]
    commands: np.ndarray
    singular_values: np.ndarray


@dataclass
class Images:
    """The camera's images.

    Attributes:
        stamp, arrival: (n,) s of simulated time: exposure, and when the recorder had it.
        first, last: (H, W, 3) rgb of the first and the last image while servoing, or None.
        camera: intrinsics and lens; where they are not known, one pixel is one normalised unit.
    """

    stamp: np.ndarray
    arrival: np.ndarray
    first: np.ndarray | None = None
    last: np.ndarray | None = None
    camera: CameraModel = CameraModel(1, 1, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))


@dataclass
class MomentsTrack:
    """Valid ImageMoments: stamp (n,) s and raw and centred moments (n, count) of an order."""

    stamp: np.ndarray
    order: int
    m: np.ndarray
    mu: np.ndarray


@dataclass
class Recording:
    """Everything a report needs.

    Attributes:
        states: of the controller.
        joint_stamp, joints: (n,) s and (n, j) measured, in the order of states.joint_names.
        camera_stamp, camera_pose: (n,) s and (n, 4, 4) `base_T_optical` from TF.
        images: of the camera.
        moments: of the target.
        outcome, reason, mend: of the loop, at the end; empty where they were not recorded.
    """

    states: States
    joint_stamp: np.ndarray
    joints: np.ndarray
    camera_stamp: np.ndarray
    camera_pose: np.ndarray
    images: Images
    moments: MomentsTrack
    outcome: str = ""
    reason: str = ""
    mend: str = ""

    @property
    def began(self) -> float:
        """Stamp of the first image that was servoed on, s."""
        return float(self.states.stamp[0])
