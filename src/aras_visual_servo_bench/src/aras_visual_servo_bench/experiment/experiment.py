"""Settings of one experiment: plant, target, cameras, start, goal, scheme and duration."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from aras_sim_bridge.description.types import SUN
from aras_sim_bridge.rendering import EXPOSURES, RENDERERS
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.setting_values import format_value
from aras_visual_servo_base.settings import SettingsBase, build, check, parameter, to_mapping
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_controller.observation.observation import CAMERA

from ..errors import ExperimentError, StudyError, catch_setting_errors, require
from ..targets.target_spec import MAX_TARGET_SIZE, TargetSpec, Vector2, check_times
from .camera_specs import HALF_TURN, MAX_DELAY, CalibrationOffset, CameraSpec, HandEyeSpec
from .refused_parameters import check_names
from .robot_spec import RobotSpec
from .starts import CameraPoseSpec, RandomStart, RelativeStart

PLANTS = ("bullet", "chain", "free", "ideal")
FREE_CAMERA_PLANTS = ("free", "ideal")
FEATURES = ("auto", "images", "exact")
COMMANDS = ("joint_states", "images")
# Keys of earlier versions, with their new names, for error messages.
RENAMED_KEYS = {
    "believed": "calibration_offset", "linger": "time_after_convergence",
    "options": "controller_parameters", "traced": "record_peak_speeds",
}  # fmt: skip
RENAMED_FEATURES = {"pictures": "images"}
CLASS_HINT = "a name, a class, or 'package.module:Class'"


@dataclass(frozen=True)
class SunSpec:
    """The sun over the Bullet arm's table: a white directional light in addition to ambient light.

    direction: direction of the sunlight (from the sun to the ground), in the world frame.
    diffuse: brightness that the sun gives to a white face perpendicular to its light, 0 to 1;
        ambient light adds 0.4.
    exposure: 'unclipped' scales both lights so that their sum is at most 1; 'gazebo' clips
        brightness above 1 to white, which shifts edges in the image.
    shines: intervals (start, end) in which the sun shines, s of simulated time; None: always.
        Ambient light is always on. The goal is taught in the light at the start.
    """

    direction: tuple[float, float, float] = SUN.direction
    diffuse: float = parameter(SUN.diffuse[0], least=0.0, most=1.0)
    exposure: str = parameter(EXPOSURES[0], choices=EXPOSURES)
    shines: tuple[Vector2, ...] | None = None

    def __post_init__(self) -> None:
        check(self, ExperimentError, "sun")
        require(any(self.direction), "sun.direction must not be zero")
        check_times(self.shines, "sun.shines")


@dataclass(frozen=True)
class IdealPlantSpec:
    """Speed limits, image bounds and end of a run on the plant 'ideal'.

    speed: limits of the twist's components, m/s and rad/s; the whole twist is scaled to respect
        them. None: no limit.
    stop: sum of the squared feature errors at which the run has converged; None: the control
        loop's usual criterion.
    unbounded: whether features outside the image are measured, too; only features behind the camera
        are then lost.
    enough: the run has converged when the true distance and angle to the goal are at most this
        fraction of their initial values; None: not used.
    farthest: the run has failed when the true distance to the goal is larger than this multiple of
        its initial value; None: not used.
    """

    speed: Vector2 | None = parameter(None, above=0.0)
    stop: float | None = parameter(None, above=0.0)
    unbounded: bool = False
    enough: float | None = parameter(None, above=0.0)
    farthest: float | None = parameter(None, above=0.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "ideal")


@dataclass(frozen=True)
class Experiment(SettingsBase):
    """Settings that determine a run completely: equal experiments give equal runs.

    An experiment is immutable. `with_changes(gain=2.0)` returns a copy with other values,
    `from_yaml(path)` reads a file, and `run(experiment)` runs an experiment. Values can have the
    types of a YAML file or be Python objects: paths, NumPy arrays and numbers, classes. If the
    value of `target`, `robot` or an entry of `cameras` is not a mapping, it sets `target.shape`,
    `robot.urdf` or the `model` of the camera. A wrong key or value raises an ExperimentError that
    suggests a correct one. Lengths are in m, angles in rad, times in s. A plant in brackets means
    that the setting acts only on this plant.

    plant: 'bullet' (simulated arm), 'chain' (arm without dynamics), 'free' (free-flying camera with
        the control loop's rate, limits and delay) or 'ideal' (camera that executes the scheme's
        twist exactly, one motion per image, as simulations in papers do).
    ideal: settings of the plant 'ideal'; see IdealPlantSpec.
    robot: settings of the robot; see RobotSpec.
    friction: whether the joints of the robot have friction (bullet).
    lag: time constant with which each joint, or the free camera, follows its command, s (chain,
        free).
    target: settings of the target; see TargetSpec. The target 'aras' is part of the shipped robot
        description; another target is placed in the world instead.
    sun: settings of the sun; see SunSpec (bullet).
    world: path of an SDF world file around the arm, or name of a shipped world such as 'workbench';
        its models, lights and scene replace the sun and the ground plane (bullet).
    camera: the true camera: name of a preset, path of a YAML file or of a calibration (ROS, OpenCV,
        Kalibr, ViSP), or settings.
    camera_xyz, camera_rpy: displacement of the camera in its link, m and rad; links that are fixed
        to the camera link move, too.
    hand_eye: file of a hand-eye calibration that gives the pose of the camera on the arm, instead
        of the robot description; see HandEyeSpec.
    calibration_offset: errors of the controller's camera calibration; see CalibrationOffset.
    cameras: several cameras by name, instead of camera, hand_eye and calibration_offset; see
        CameraSpec. The scheme names the cameras that it uses ('points@left+points@right'); by
        default, it uses the first camera. Other cameras only record images.
    features: 'images' measures features in images; 'exact' computes them from the true poses,
        without image, tracker and noise; 'auto' is 'images' on the Bullet arm, otherwise 'exact'.
    noise: standard deviation of the image noise, grey levels.
    jitter: standard deviation of the noise of exact features, px.
    delay: time from an exposure until the resulting command takes effect, including computing time,
        s.
    commands: when the controller sends commands. 'joint_states': with each joint state, as a ROS
        graph in real time. 'images': one command per image, as a ROS graph in lockstep; the delay
        is then rounded up to whole image periods.
    start: name of a pose, joints (rad, m), a CameraPoseSpec, a RandomStart, or a RelativeStart.
    goal: name or path of a goal file; or joints or a CameraPoseSpec at which the goal is taught.
    scheme: name, class, or 'package.module:Class' of the scheme.
    law: name of the control law.
    gain: gain of the control law, 1/s; None: the default of the law.
    controller_parameters: other parameters of the controller node, by name.
    duration: run time after the first image, s.
    time_after_convergence: time for which the run continues after it has converged, s; None: until
        `duration` is over.
    reached: maximum distance (m) and angle (rad) at which the goal is reached; None: 0.15 % of the
        target's depth at the goal and 0.3 degrees, which are the tolerances of the outcome
        'converged'.
    seed: seed of all random numbers.
    renderer: accepted for compatibility; all names select the same renderer.
    record_peak_speeds: whether to record the maximum speed of each joint over all physics steps
        (bullet).
    """

    fault = ExperimentError
    renamed_keys = RENAMED_KEYS

    plant: str = parameter("bullet", choices=PLANTS)
    ideal: IdealPlantSpec = IdealPlantSpec()
    robot: RobotSpec = RobotSpec()
    friction: bool = True
    lag: float = parameter(0.04, "s", least=0.0)
    target: TargetSpec = TargetSpec()
    sun: SunSpec = SunSpec()
    world: str = ""
    camera: str | Mapping[str, Any] = "original"
    camera_xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m")
    camera_rpy: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "rad", least=-HALF_TURN, most=HALF_TURN
    )
    hand_eye: HandEyeSpec | None = None
    calibration_offset: CalibrationOffset = CalibrationOffset()
    cameras: Mapping[str, CameraSpec] = parameter({})
    features: str = parameter("auto", choices=FEATURES, renamed=RENAMED_FEATURES)
    noise: float = parameter(0.0, "grey levels", least=0.0)
    jitter: float = parameter(0.0, "px", least=0.0)
    delay: float = parameter(0.015, "s", least=0.0, most=MAX_DELAY)
    commands: str = parameter("joint_states", choices=COMMANDS)
    start: str | tuple[float, ...] | CameraPoseSpec | RandomStart | RelativeStart = parameter(
        "2016", name=True
    )
    goal: str | tuple[float, ...] | CameraPoseSpec = parameter("auto", name=True)
    scheme: str = parameter("moments", name=True, importable=True, expected=CLASS_HINT)
    law: str = parameter("proportional", importable=True, expected=CLASS_HINT)
    gain: float | None = parameter(None, "1/s", above=0.0)
    controller_parameters: Mapping[str, Any] = parameter({})
    duration: float = parameter(8.0, "s", above=0.0)
    time_after_convergence: float | None = parameter(0.5, "s", least=0.0)
    reached: Vector2 | None = parameter(None, above=0.0)
    seed: int = parameter(0, least=0)
    renderer: str = parameter("auto", choices=RENDERERS)
    record_peak_speeds: bool = False

    def __post_init__(self) -> None:
        check(self, ExperimentError)
        check_names(self.controller_parameters)
        require(self.hand_eye is None or self.plant not in FREE_CAMERA_PLANTS,
                f"hand_eye gives the camera's pose on an arm, but plant '{self.plant}' has no "
                "arm: use plant chain or bullet")
        self._check_cameras()
        if self.plant == "bullet":
            self._check_bullet()
        else:
            for is_set, fault in (
                (self.target.model, "target.model names a model in a world, and only plant bullet "
                 "has a world"),
                (self.record_peak_speeds, "record_peak_speeds needs physics steps, which only "
                 "plant bullet has"),
                (self.world, "world acts only on plant bullet"),
                (self.sun != SunSpec(), "sun acts only on plant bullet"),
            ):  # fmt: skip
                require(not is_set, f"{fault}: leave it out, or use plant bullet")
        require(
            not self.has_images or not self.jitter,
            "jitter acts only on exact features, but this experiment measures features in images: "
            "set noise instead, or set features to exact",
        )
        require(
            self.has_images or not self.noise,
            "noise acts only on images, but this experiment has exact features: set jitter (px) "
            "instead, or set features to images",
        )

    def _check_bullet(self) -> None:
        """Check the target and the surroundings of the Bullet arm.

        Raises:
            ExperimentError: the target is larger than the table, or settings exclude each other.
        """
        target = self.target
        is_own_table = not self.world and self.robot.urdf == RobotSpec().urdf
        for i, length in enumerate(target.size or () if is_own_table else ()):
            require(length <= MAX_TARGET_SIZE, f"target.size[{i}] is {length}, must be <= "
                    f"{MAX_TARGET_SIZE:g} m, the size of the table: use a smaller target, or your "
                    "own world or robot")
        require(not self.world or replace(self.sun, exposure=EXPOSURES[0]) == SunSpec(),
                "the world file contains the lights: leave out all keys of sun except exposure, or "
                "leave out world")
        require(bool(self.world) or not target.model,
                "target.model names a model in a world file, but world is not set: set world to "
                "the path or name of the file")
        has_own_pose = not target.motion.is_static or any(target.pose)
        require(not (target.is_in_description and has_own_pose),
                "target.pose and target.motion do not act on a target in the robot description of "
                "the Bullet arm: set target.shape, too, for a separate target")
        is_in_robot = target.is_in_description or target.shape == "aras"
        require(target.occluder is None or not is_in_robot,
                "target.occluder is not available for 'aras' and targets in the robot description: "
                "set another target.shape, such as square")
        require(is_in_robot or any(target.pose),
                "target.pose is missing: give the target's pose on the Bullet arm's table, whose "
                "top is at z = 0.59 m, for example [0, 0, 0.591, 0, 0, 0] for the table's middle")
        require(not self.robot.target_frame or target.is_mountable,
                "a target on a link of the arm (robot.target_frame) has no motion of its own: "
                "leave out target.motion, target.occluded and target.box")

    def _check_cameras(self) -> None:
        if not self.cameras:
            return
        require(
            self.camera == "original"
            and self.calibration_offset == CalibrationOffset()
            and self.hand_eye is None,
            "camera, hand_eye and calibration_offset cannot be combined with cameras: set them "
            "for each entry of cameras",
        )
        require(self.plant != "ideal",
                "plant 'ideal' has only one camera: leave out cameras, or use plant free, chain "
                "or bullet")
        for name, camera in self.cameras.items():
            require(name.isidentifier(),
                    f"cameras: '{name}' is no valid name: use letters, digits and _")
            if camera.target is not None or camera.target_frame:
                self._check_own_target(name, camera)

    def _check_own_target(self, name: str, camera: CameraSpec) -> None:
        """Check the target that one of the cameras observes instead of the experiment's target.

        Raises:
            ExperimentError: the plant does not support such targets, or other settings exclude it.
        """
        target = camera.target
        require(
            not camera.target_frame or self.plant not in FREE_CAMERA_PLANTS,
            f"cameras.{name}.target_frame is a link of an arm, but plant '{self.plant}' has no "
            "arm: use plant chain or bullet",
        )
        require(
            not camera.target_frame or target is not None,
            f"cameras.{name}.target_frame needs a target on this link: set "
            f"cameras.{name}.target.shape, and .pose relative to the link",
        )
        require(
            target.is_mountable or not camera.target_frame and target.is_plain,
            f"cameras.{name}.target may only have "
            + ("shape, size and pose, because its link moves it" if camera.target_frame else
               "shape, size, pose and motion") + ": leave out the other keys",
        )
        require(
            self.plant != "bullet" or target.shape != "aras" and (
                bool(camera.target_frame) or any(target.pose)
            ),
            f"cameras.{name}.target needs a shape and a pose: set cameras.{name}.target.shape (not "
            f"'aras') and cameras.{name}.target.pose",
        )

    @property
    def camera_specs(self) -> Mapping[str, CameraSpec]:
        """The cameras by name; if `cameras` is empty, the single camera that `camera` describes."""
        if self.cameras:
            return self.cameras
        return {CAMERA: CameraSpec(self.camera, calibration_offset=self.calibration_offset)}

    @property
    def has_images(self) -> bool:
        """True if features are measured in images, False if they are computed from true poses."""
        return self.features == "images" or (self.features == "auto" and self.plant == "bullet")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Experiment:
        """Make an experiment from keys and values; missing keys have their default values.

        Raises:
            ExperimentError: a key or value is wrong; the message suggests a correct one.
        """
        return build(cls, values, "", ExperimentError)

    @classmethod
    def from_yaml(cls, path: str | Path) -> Experiment:
        """Read an experiment from a YAML file.

        Raises:
            ExperimentError: the file cannot be read, or a key or value is wrong.
        """
        require(isinstance(path, str | Path),
                f"{format_value(path)} is not a path: give the path of a YAML file")
        return cls.from_mapping(read_yaml(path, ExperimentError) or {})

    @classmethod
    def load(cls, source: Experiment | Mapping[str, Any] | str | Path | None) -> Experiment:
        """Return an experiment unchanged, or make one from keys and values or from a YAML file.

        Raises:
            ExperimentError: the source is none of these, or a key or value is wrong.
        """
        if isinstance(source, cls):
            return source
        if isinstance(source, Mapping):
            return cls.from_mapping(source)
        if isinstance(source, str | Path):
            return cls.from_yaml(source)
        raise ExperimentError(
            f"{format_value(source)} is not an experiment: give Experiment(...), a mapping, or "
            "the path of a YAML file; for several experiments use a Study"
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the keys whose values differ from the defaults, as input of `from_mapping`."""
        return to_mapping(self)

    @property
    def with_absolute_start(self) -> Experiment:
        """Return the experiment with a RelativeStart replaced by the camera pose that it describes.

        Raises:
            ExperimentError: the start is a RelativeStart, and the goal is not a CameraPoseSpec.
        """
        if not isinstance(self.start, RelativeStart):
            return self
        require(
            isinstance(self.goal, CameraPoseSpec),
            f"start.kind '{self.start.kind}' is relative to the goal pose: set goal to a pose",
        )
        poses = (
            matrix_from_xyz_rpy(pose[:3], pose[3:]) for pose in (self.goal.pose, self.target.pose)
        )
        return self.with_changes(start=CameraPoseSpec(self.start.compute_pose(*poses, self.seed)))

    def with_changes(self, **changes: Any) -> Experiment:
        """Return a copy of this experiment with some values changed.

        A mapping changes only the keys that it names: `with_changes(target={"size": [0.1, 0.1]})`
        does not change the target's shape. Keys can be dotted paths:
        `with_changes(**{"camera.effects.gain": 2.0})`. To replace a whole value, give an object,
        such as `TargetSpec(shape="square")`.

        Raises:
            ExperimentError: a key or value is wrong; the message suggests a correct one.
        """
        from .overrides import with_overrides

        merged = {
            key.partition(".")[0] for key, value in changes.items()
            if "." in key or isinstance(value, Mapping)
        }  # fmt: skip
        here = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)
                if f.name not in merged}  # fmt: skip
        keys = {key: value for key, value in self.to_mapping().items() if key in merged}
        with catch_setting_errors(StudyError):
            values = with_overrides({**here, **keys}, changes)
        return self.from_mapping(values)
