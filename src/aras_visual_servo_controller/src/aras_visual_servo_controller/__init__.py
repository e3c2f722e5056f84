"""Visual servoing with a robot arm: features, control laws, schemes and the control loop.

`__all__` lists the public interface. `FIRST_PROJECT` lists the names that a first project needs.
Each name is imported when it is first used.
"""

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy_imports import lazy_exports

if TYPE_CHECKING:
    from aras_visual_servo_base.settings import parameter as parameter
    from aras_visual_servo_camera.camera_model import CameraModel as CameraModel
    from aras_visual_servo_camera.interaction import point_interaction as point_interaction
    from aras_visual_servo_camera.moment_feature_values import Reference as Reference
    from aras_visual_servo_camera.moment_feature_values import (
        compute_moment_features as compute_moment_features,
    )
    from aras_visual_servo_camera.moments import Moments as Moments
    from aras_visual_servo_camera.trackers.base import Tracker as Tracker

    from .errors import ConfigurationError as ConfigurationError
    from .errors import MeasurementError as MeasurementError
    from .errors import ServoError as ServoError
    from .features.base import FEATURES as FEATURES
    from .features.base import Feature as Feature
    from .features.base import FeatureMeasurement as FeatureMeasurement
    from .features.base import Stack as Stack
    from .features.interaction_check import check_interaction_matrix as check_interaction_matrix
    from .features.points import PointFeature as PointFeature
    from .features.points import Points as Points
    from .features.remote_camera_feature import RemoteCameraFeature as RemoteCameraFeature
    from .goals.goal import Goal as Goal
    from .kinematics.arm import Arm as Arm
    from .kinematics.differential_ik import DifferentialIK as DifferentialIK
    from .kinematics.joint_sample import JointSample as JointSample
    from .kinematics.task import Task as Task
    from .laws.base import Law as Law
    from .laws.wrappers import create_law as create_law
    from .loop.servo import Servo as Servo
    from .observation.feature_observer import FeatureObserver as FeatureObserver
    from .observation.observation import Need as Need
    from .observation.observation import Observation as Observation
    from .schemes.base import JointController as JointController
    from .schemes.base import Scheme as Scheme
    from .schemes.base import SchemeOutput as SchemeOutput
    from .schemes.registry import create_scheme as create_scheme

_FIRST = {
    "Feature": ".features.base",
    "FeatureMeasurement": ".features.base",
    "Need": ".observation.observation",
    "Observation": ".observation.observation",
    "Goal": ".goals.goal",
    "check_interaction_matrix": ".features.interaction_check",
    "Law": ".laws.base",
    "Scheme": ".schemes.base",
    "JointController": ".schemes.base",
    "SchemeOutput": ".schemes.base",
    "Task": ".kinematics.task",
    "MeasurementError": ".errors",
}
_FURTHER = {
    "PointFeature": ".features.points",
    "Points": ".features.points",
    "point_interaction": "aras_visual_servo_camera.interaction",
    "Stack": ".features.base",
    "RemoteCameraFeature": ".features.remote_camera_feature",
    "FEATURES": ".features.base",
    "create_law": ".laws.wrappers",
    "create_scheme": ".schemes.registry",
    "Arm": ".kinematics.arm",
    "DifferentialIK": ".kinematics.differential_ik",
    "JointSample": ".kinematics.joint_sample",
    "FeatureObserver": ".observation.feature_observer",
    "Servo": ".loop.servo",
    "CameraModel": "aras_visual_servo_camera.camera_model",
    "Moments": "aras_visual_servo_camera.moments",
    "Reference": "aras_visual_servo_camera.moment_feature_values",
    "compute_moment_features": "aras_visual_servo_camera.moment_feature_values",
    "parameter": "aras_visual_servo_base.settings",
    "Tracker": "aras_visual_servo_camera.trackers.base",
    "ServoError": ".errors",
    "ConfigurationError": ".errors",
}
FIRST_PROJECT = tuple(_FIRST)
__all__ = [*_FIRST, *_FURTHER]
# Type checkers must not see __getattr__: they accept any name of a module that has it.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy_exports(__name__, {**_FIRST, **_FURTHER})
