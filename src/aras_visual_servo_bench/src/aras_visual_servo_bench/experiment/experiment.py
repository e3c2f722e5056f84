"""An experiment is data: plant, target, cameras, start, goal, scheme, and for how long."""

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
from aras_visual_servo_base.settings import KeywordSettings, build, check, parameter, to_mapping
from aras_visual_servo_base.yaml_files import read_yaml
from aras_visual_servo_controller.observation.observation import CAMERA

from ..errors import ExperimentError, StudyError, require
from ..targets.target_spec import MAX_TARGET_SIZE, TargetSpec, Vector2, check_times
from .cameras import HALF_TURN, MAX_DELAY, CalibrationOffset, CameraSpec, HandEyeSpec
from .robots import RobotSpec
from .starts import CameraPose, RelativeStart, Sampler

PLANTS = ("bullet", "chain", "free", "ideal")
FREE_CAMERA_PLANTS = ("free", "ideal")
FEATURES = ("auto", "images", "exact")
COMMANDS = ("joint_states", "images")
# Parameters of the controller that the experiment has as keys of its own.
SHARED_PARAMETERS = ("scheme", "law", "gain", "duration")
CLASS_HINT = "a name, a class, or 'package.module:Class'"


@dataclass(frozen=True)
class SunSpec:
    """The sun over the Bullet arm's table; its light is white, and ambient light is there besides.

    direction: from the sun to the ground, in the world. diffuse: its part of what a white face
    square to it gives back; 0.4 more come from around. exposure: 'unclipped': both are scaled so
    that they are 1 at most; 'gazebo': what is above 1 is white all the same, which moves edges.
    shines: from when and until when it does, s of simulated time, as often as it comes; ambient
    light stays, and the goal is taught in the light of the beginning. None: always.
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
class IdealSpec:
    """How the ideal camera flies, and when its run is over.

    speed: m/s and rad/s; where a component of the twist is beyond, the whole twist is scaled.
    stop: sum of the squared errors at which the run has converged; None: as every loop.
    unbounded: what leaves the picture is seen all the same, and behind the camera alone is lost.
    enough: part of the first distance and angle from the goal that counts as converged, by the
        truth; it ends the run. farthest: times the first distance at which the run has failed.
    """

    speed: Vector2 | None = parameter(None, above=0.0)
    stop: float | None = parameter(None, above=0.0)
    unbounded: bool = False
    enough: float | None = parameter(None, above=0.0)
    farthest: float | None = parameter(None, above=0.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "ideal")


@dataclass(frozen=True)
class Experiment(KeywordSettings):
    """Everything that decides how a run goes; the same experiment gives the same run.

    Immutable: `with_changes(gain=2.0)` returns a copy with other values, `from_yaml(path)` reads a
    file, and `run(experiment)` carries it out. Values may be those of a YAML file or of Python:
    paths,
    NumPy arrays and numbers, classes. A value that is no mapping is that of `target.shape`,
    `robot.urdf` or a camera's `model`. A wrong key or value raises an ExperimentError with the
    nearest right one. Lengths are in m, angles in rad, times in s.

    plant: 'bullet' (simulated arm), 'chain' (arm without dynamics), 'free' (flying camera with
        the servo loop's ticks, limits and delay) or 'ideal' (the scheme's own twist, one exact
        motion an image: what papers compute).
    ideal: see Ideal.
    robot: see RobotSpec. friction: of its joints (bullet). lag: of each joint (chain, free), s.
    target: see TargetSpec; 'aras' is part of the Bullet arm's description, others are put into the
        world in its place.
    sun: see SunSpec (bullet). world: an SDF world file around the arm, by path or as 'workbench' of
        the shipped ones: its models, lights and scene, in place of the sun and the plain ground
        (bullet).
    camera: name of a preset, path of a YAML file or of a calibration (ROS, OpenCV, Kalibr, ViSP),
        or the settings: the true one.
    camera_xyz, camera_rpy: how it is moved in its link, m and rad; all that hangs on it goes along.
    hand_eye: file of a hand-eye calibration that says where the camera is on the arm, in place of
        the robot's description; see HandEyeSpec.
    calibration_offset: how the controller's idea of the camera differs; see CalibrationOffset.
    cameras: several cameras by name, in place of camera and believed; see CameraSpec. A scheme says
        which it reads ('points@left+points@right', by default the first); the others only watch.
    features: 'images', 'exact' (the truth of them, without picture, tracker and noise), 'auto':
        pictures of the Bullet arm.
    noise: of grey levels, standard deviation. jitter: of exact features, px.
    delay: s from an exposure to its answer, computing included.
    commands: 'joint_states': streamed with each of them, as on a graph in real time; 'images':
        one an image, as on a graph in lockstep: an answer moves the arm from the first image on
        that its delay is over, so a delay is rounded up to whole image periods.
    start: name of a pose, joints (rad, m), a CameraPose, a Sampler, or a RelativeStart.
    goal: name or path of a goal file, joints, or a CameraPose, at which the goal is taught.
    scheme: name, class, or 'package.module:Class'. law: its name. gain: 1/s; None: the law's own.
    options: further parameters of the controller, by name, as its node has them.
    duration: s after the first image. time_after_convergence: s to go on after it has converged;
        None: to the end.
    reached: m and rad within which the goal counts as reached; None: 0.15 % of the target's depth
        at the goal and 0.3 degrees, which plain 'converged' promises.
    seed: of all that is random. renderer: of the Bullet arm; all names mean one.
    traced: note each joint's greatest speed at every step of the physics.
    """

    fault = ExperimentError

    plant: str = parameter("bullet", choices=PLANTS)
    ideal: IdealSpec = IdealSpec()
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
    features: str = parameter("auto", choices=FEATURES)
    noise: float = parameter(0.0, "grey levels", least=0.0)
    jitter: float = parameter(0.0, "px", least=0.0)
    delay: float = parameter(0.015, "s", least=0.0, most=MAX_DELAY)
    commands: str = parameter("joint_states", choices=COMMANDS)
    start: str | tuple[float, ...] | CameraPose | Sampler | RelativeStart = parameter(
        "2016", name=True
    )
    goal: str | tuple[float, ...] | CameraPose = parameter("auto", name=True)
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
        for name in SHARED_PARAMETERS:
            require(
                name not in self.controller_parameters,
                f"controller_parameters.{name}: {name} is a key of the experiment itself; give it "
                "there",
            )
        require(self.hand_eye is None or self.plant not in FREE_CAMERA_PLANTS,
                f"hand_eye says where an arm carries the camera, and plant '{self.plant}' has no "
                "arm: use chain or bullet")
        self._check_cameras()
        if self.plant == "bullet":
            self._check_size()
            require(
                not self.world or replace(self.sun, exposure=EXPOSURES[0]) == SunSpec(),
                "the lights are those of the world file: give sun.exposure alone, or no world",
            )
            require(bool(self.world) or not self.target.model,
                    "target.model stands in a world file: give its path or name as world")
            own = not (self.target.motion.is_static and not any(self.target.pose))
            require(
                not (self.target.is_in_description and own),
                "a target in the Bullet arm's description lies still where that has it: give its "
                "shape a pose for one that moves",
            )
            require(
                self.target.occluder is None
                or not (self.target.is_in_description or self.target.shape == "aras"),
                "an occluder on the Bullet arm's table is made for another target.shape, as square",
            )
            require(
                self.target.is_in_description
                or self.target.shape == "aras"
                or any(self.target.pose),
                "target.pose says where on the Bullet arm's table the target lies: its top is at "
                "z = 0.59, so [0, 0, 0.591, 0, 0, 0] is its middle",
            )
            require(
                not self.robot.target_frame or self.target.is_mountable,
                "a target that the arm moves is carried by one of its links: leave out "
                "target.motion, occluded and box",
            )
        else:
            require(not self.target.model,
                    "target.model is of a world, for the Bullet arm: other plants have none")
            require(
                not self.record_peak_speeds,
                "traced is for the Bullet arm: other plants have no steps",
            )
            require(not self.world, "world is for the Bullet arm: other plants have none")
            require(self.sun == SunSpec(), "sun is for the Bullet arm: other plants have no light")
        require(
            not self.has_images or not self.jitter,
            "jitter is for exact features: give noise for pictures",
        )
        require(self.has_images or not self.noise, "noise is for pictures: give jitter, in px")

    def _check_size(self) -> None:
        """ExperimentError where a target is larger than the shipped robot's table."""
        if self.world or self.robot.urdf != RobotSpec().urdf:
            return
        for i, length in enumerate(self.target.size or ()):
            require(length <= MAX_TARGET_SIZE, f"target.size[{i}] is {length}, must be <= "
                    f"{MAX_TARGET_SIZE:g} m, the table's: use a world or a robot of your own")

    def _check_cameras(self) -> None:
        if not self.cameras:
            return
        require(
            self.camera == "original"
            and self.calibration_offset == CalibrationOffset()
            and self.hand_eye is None,
            "camera, hand_eye and believed are of an experiment with one camera: cameras has them "
            "for each",
        )
        require(self.plant != "ideal", "plant 'ideal' has one camera: use free, chain or bullet")
        for name, camera in self.cameras.items():
            require(name.isidentifier(), f"cameras: '{name}' is no name: letters, digits and _ are")
            if camera.target is not None or camera.target_frame:
                self._check_own_target(name, camera)

    def _check_own_target(self, name: str, camera: CameraSpec) -> None:
        """ExperimentError where a camera cannot look at a target of its own."""
        target = camera.target
        require(
            not camera.target_frame or self.plant not in FREE_CAMERA_PLANTS,
            f"cameras.{name}.target_frame is a link of the arm's, and plant '{self.plant}' has no "
            "arm: use chain or bullet",
        )
        require(
            not camera.target_frame or target is not None,
            f"cameras.{name}.target_frame carries what the camera looks at: give its shape, and "
            f"its pose in that link, as cameras.{name}.target",
        )
        require(
            target.is_mountable or not camera.target_frame and target.is_plain,
            f"cameras.{name}.target has a shape, a size and a pose"
            + (", and moves with its link alone" if camera.target_frame else ", and a motion")
            + ": leave out the rest",
        )
        require(
            self.plant != "bullet" or target.shape != "aras" and (
                bool(camera.target_frame) or any(target.pose)
            ),
            f"cameras.{name}.target: give it a shape, and a pose that says where it lies",
        )

    @property
    def camera_specs(self) -> Mapping[str, CameraSpec]:
        """Its cameras by name; `camera` is the only one of them where `cameras` names none."""
        if self.cameras:
            return self.cameras
        return {CAMERA: CameraSpec(self.camera, calibration_offset=self.calibration_offset)}

    @property
    def has_images(self) -> bool:
        """Whether the features are taken from pictures."""
        return self.features == "images" or (self.features == "auto" and self.plant == "bullet")

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Experiment:
        """An experiment of the keys that are given; the others keep their defaults.

        Raises:
            ExperimentError: naming the key, what is wrong and what would be right.
        """
        return build(cls, values, "", ExperimentError)

    @classmethod
    def from_yaml(cls, path: str | Path) -> Experiment:
        """An experiment of a YAML file; ExperimentError as above."""
        require(isinstance(path, str | Path), f"{format_value(path)} is no path of a YAML file")
        return cls.from_mapping(read_yaml(path, ExperimentError) or {})

    @classmethod
    def load(cls, source: Experiment | Mapping[str, Any] | str | Path | None) -> Experiment:
        """Return an experiment as it is, or make it of keys with values or of a YAML file.

        Raises:
            ExperimentError: it is none of these, or its keys are wrong.
        """
        if isinstance(source, cls):
            return source
        if isinstance(source, Mapping):
            return cls.from_mapping(source)
        if isinstance(source, str | Path):
            return cls.from_yaml(source)
        raise ExperimentError(
            f"{format_value(source)} is no experiment: give Experiment(...), keys with values, or "
            "the path "
            "of a YAML file; for several experiments use a Study"
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the keys that differ from their defaults; `from_mapping` takes them."""
        return to_mapping(self)

    @property
    def with_absolute_start(self) -> Experiment:
        """The same with the pose that a start about the goal's comes to.

        Raises:
            ExperimentError: its goal is no pose, to which the start could be relative.
        """
        if not isinstance(self.start, RelativeStart):
            return self
        require(
            isinstance(self.goal, CameraPose),
            f"start.kind '{self.start.kind}' is relative to the goal: give it as a pose",
        )
        poses = (
            matrix_from_xyz_rpy(pose[:3], pose[3:]) for pose in (self.goal.pose, self.target.pose)
        )
        return self.with_changes(start=CameraPose(self.start.compute_pose(*poses, self.seed)))

    def with_changes(self, **changes: Any) -> Experiment:
        """Return this experiment with some values changed, and nothing else.

        A mapping changes the keys that it names: `with_changes(target={"size": [0.1, 0.1]})` keeps
        the target's shape. Keys of a mapping may be dotted:
        `with_changes(**{"camera.effects.gain":
        2.0})`. To replace a whole value, give an object, as `TargetSpec(shape="square")`.

        Raises:
            ExperimentError: naming the key, what is wrong and how to correct it.
        """
        from .overrides import with_overrides

        merged = {
            key.partition(".")[0] for key, value in changes.items()
            if "." in key or isinstance(value, Mapping)
        }  # fmt: skip
        here = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)
                if f.name not in merged}  # fmt: skip
        keys = {key: value for key, value in self.to_mapping().items() if key in merged}
        try:
            values = with_overrides({**here, **keys}, changes)
        except StudyError as error:
            raise ExperimentError(str(error)) from None
        return self.from_mapping(values)
