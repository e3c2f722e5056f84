"""Settings of an experiment's robot."""

from __future__ import annotations

from dataclasses import dataclass

from aras_visual_servo_base.settings import check, parameter

from ..errors import ExperimentError
from .camera_specs import CameraSpec


@dataclass(frozen=True)
class RobotSpec:
    """Settings of the robot; the defaults describe the ARAS robot.

    urdf: path or package:// URL of the robot description.
    config: path or package:// URL of the YAML file with the controllers.
    namespace: namespace of the robot. The YAML file may contain the controllers at the top level or
        as keys below this namespace.
    camera_frame: optical frame of the robot's camera.
    camera: name of this camera in the robot description; '': the first camera.
    target_frame: link that carries the target (eye-to-hand); the poses of target and goal are then
        in the frame of this link. '': the target is in the world.
    controllers: names of the joint controllers to use; empty: all controllers that control a single
        joint.
    joint_states: name of the controller that publishes the joint states.
    cameras: package whose folder config/cameras contains the camera presets.
    search: folders in which the packages of package:// URLs are searched.
    """

    urdf: str = parameter(
        "package://aras_visual_servo_gazebo/robots/aras_visual_servo.urdf", shorthand=True
    )
    config: str = "package://aras_visual_servo_gazebo/config/aras_visual_servo_control.yaml"
    namespace: str = "/aras_visual_servo"
    camera_frame: str = "camera_optical_frame"
    camera: str = ""
    target_frame: str = ""
    controllers: tuple[str, ...] = ()
    joint_states: str = "joint_state_controller"
    cameras: str = "aras_visual_servo_gazebo"
    search: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check(self, ExperimentError, "robot")

    def find_carrier(self, camera: CameraSpec | None) -> str:
        """Return the link that carries the target of a camera; '' if the target is in the world.

        camera: settings of the camera; None for the robot's own camera.
        """
        own = "" if camera is None else camera.target_frame
        return own or self.target_frame
