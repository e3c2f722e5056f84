"""Parameters of the controller node, checked before the first step.

Every parameter is one field of `Settings`; the table in the package's README lists the same.
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from .. import mounting
from ..desired import Desired
from ..errors import ConfigurationError, ServoError
from ..goals import from_geometry
from ..kinematics import J1, JOINT_NAMES, Kinematics
from ..resolver import Resolver, ResolverSettings
from ..tasks import JointLimitAvoidance, JointLimits, Posture, SingularityAvoidance, Task
from .laws import Adaptive, Law, Proportional
from .schemes import create
from .servo import Servo, ServoSettings

# The laboratory's two initial poses: gantry (m), J1, J2, J3, J5, J6 (rad).
STARTS = {
    "2015": (0.1, 0.0, *np.radians([10.0, -5.0, -5.0, 0.0]).tolist()),
    "2016": (-0.1, 0.0, *np.radians([20.0, -15.0, -5.0, 10.0]).tolist()),
}
CONFIG = Path("config")


@dataclass(frozen=True)
class Settings:
    """Private parameters of the node, with their defaults; lengths in m, angles in rad.

    Attributes:
        scheme: 'moments', 'moments_2016', 'kernel' or 'package.module:Class'.
        start: '2015', '2016', 'none' (servo from where the robot stands), or six joint values.
        desired: 'auto' (that of the start), '2015', '2016', or the path of a YAML file.
        law: 'proportional' or 'adaptive'.
        gain: of the proportional law, 1/s.
        gain_zero, gain_infinity, gain_slope: of the adaptive law, 1/s, 1/s, 1/(s unit).
        ramp: time constant with which the gain rises at the start, s; 0 for none.
        smoothing: time constant of the low-pass on the features' errors, s; 0 for none.
        hold: time that every error must stay below its threshold, s.
        max_velocity: of the six joints, m/s and rad/s.
        lower, upper: position limits of the six joints, m and rad.
        lead: greatest distance of the commands from the measured joints, m and rad.
        pitch_gain: 1/s with which the camera is kept level.
        posture_gain: 1/s with which J1 is drawn to 0 by the redundancy.
        singularity_avoidance: add the laboratory's manipulability gradient to the redundancy.
        elbow: side of the elbow, +1 or -1, when the arm is straight.
        lockstep: approach at the camera's pace too, so that every image has exactly one answer;
            taken from the simulator's speed_mode unless given.
        listeners: subscribers of controller/state to wait for before moving, 5 s at most, so that
            a recording has the run from its beginning.
        image_timeout, joint_timeout: silence after which the node says what it waits for, s.
    """

    scheme: str = "moments"
    start: str | tuple[float, ...] = "2016"
    desired: str = "auto"
    law: str = "proportional"
    gain: float = 3.0
    gain_zero: float = 5.0
    gain_infinity: float = 2.0
    gain_slope: float = 30.0
    ramp: float = 0.1
    smoothing: float = 0.1
    hold: float = 2.0
    max_velocity: tuple[float, ...] = JointLimits.velocity
    lower: tuple[float, ...] = JointLimits.lower
    upper: tuple[float, ...] = JointLimits.upper
    lead: tuple[float, ...] = ServoSettings.lead
    pitch_gain: float = 3.0
    posture_gain: float = 1.0
    singularity_avoidance: bool = False
    elbow: int = -1
    image_timeout: float = 1.0
    joint_timeout: float = 1.0
    lockstep: bool = False
    listeners: float = 0.0
    package: Path = field(default=Path("."), metadata={"internal": True})

    @classmethod
    def from_mapping(cls, raw: Mapping[str, Any], package: Path = Path(".")) -> "Settings":
        """Check what the parameter server holds.

        Args:
            raw: name to value, as rosparam gives them.
            package: directory of this package, where config/ is.

        Raises:
            ConfigurationError: naming the parameter, what is wrong and what would be right.
        """
        known = {f.name: f for f in fields(cls) if not f.metadata.get("internal")}
        values: dict[str, Any] = {}
        for name, value in raw.items():
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}"
                raise ConfigurationError(f"unknown parameter ~{name}: {hint}")
            values[name] = _convert(name, value, known[name].default)
        settings = cls(**values, package=package)
        settings._check()
        return settings

    def _check(self) -> None:
        for name in ("gain", "gain_zero", "gain_infinity", "gain_slope", "hold"):
            if getattr(self, name) <= 0.0:
                raise ConfigurationError(f"parameter ~{name} is {getattr(self, name)}, must be > 0")
        for name in ("ramp", "smoothing", "pitch_gain", "posture_gain", "listeners"):
            if getattr(self, name) < 0.0:
                raise ConfigurationError(
                    f"parameter ~{name} is {getattr(self, name)}, must be >= 0"
                )
        for name in ("image_timeout", "joint_timeout"):
            if getattr(self, name) < 0.1:
                raise ConfigurationError(
                    f"parameter ~{name} is {getattr(self, name)}, must be at least 0.1 s"
                )
        if min(self.lead) <= 0.0:
            raise ConfigurationError("parameter ~lead must hold numbers above 0")
        if self.law not in ("proportional", "adaptive"):
            raise ConfigurationError(
                f"parameter ~law is '{self.law}': use proportional or adaptive"
            )
        if self.elbow not in (-1, 1):
            raise ConfigurationError(f"parameter ~elbow is {self.elbow}: use -1 or 1")
        self._limits()
        start = self.start_joints()
        if start is not None:
            for name, value, low, high in zip(
                JOINT_NAMES, start, self.lower, self.upper, strict=True
            ):
                if not low <= value <= high:
                    raise ConfigurationError(
                        f"parameter ~start puts {name} at {value:.4f}, outside its limits "
                        f"{low:.4f} to {high:.4f}"
                    )

    def start_joints(self) -> tuple[float, ...] | None:
        """The six joints of the start pose, or None for 'none'."""
        if not isinstance(self.start, str):
            return self.start
        if self.start == "none":
            return None
        if self.start not in STARTS:
            raise ConfigurationError(
                f"parameter ~start is '{self.start}': use {', '.join(STARTS)}, none or a list of "
                "six joint values"
            )
        return STARTS[self.start]

    def desired_path(self) -> Path:
        """The YAML file of the desired pose."""
        name = self.desired
        if name == "auto":
            name = self.start if isinstance(self.start, str) and self.start in STARTS else "2016"
        if name in STARTS:
            return self.package / CONFIG / f"desired_{name}.yaml"
        return Path(name).expanduser()

    def load_desired(self, kinematics: Kinematics) -> Desired:
        """The desired features, for the camera as these kinematics have it mounted.

        Those of the laboratory's two goals are worked out anew for a camera that was moved.

        Raises:
            ConfigurationError: the file cannot be used, or was taught with another mounting.
        """
        path = self.desired_path()
        desired = Desired.load(path)
        if mounting.same(desired.mounting, kinematics.mounting):
            return desired
        places = (
            f"with the camera at {mounting.words(desired.mounting)} of {mounting.FLANGE}; now it "
            f"is at {mounting.words(kinematics.mounting)}"
        )
        if path.parent != self.package / CONFIG:
            raise ConfigurationError(
                f"the desired features {path} were taught {places}: teach them anew (rosrun "
                f"aras_visual_servo_controller teach {path.name})"
            )
        try:
            return from_geometry(desired.joints, f"{desired.name}, camera moved", kinematics)
        except ServoError as error:
            raise ConfigurationError(
                f"{desired.name} is a view {places}, where there is none ({error}): move it less, "
                "or teach a goal of your own (rosrun aras_visual_servo_controller teach)"
            ) from error

    def build(self, flange_T_optical: np.ndarray | None = None) -> Servo:
        """The loop that these parameters describe.

        Args:
            flange_T_optical: the camera's mounting (4, 4); None: the robot's own.

        Raises:
            ConfigurationError: the desired features or the scheme cannot be used.
        """
        kinematics = Kinematics(mounting=flange_T_optical)
        desired = self.load_desired(kinematics)
        limits = self._limits()
        tasks: list[Task] = [Posture(J1, 0.0, self.posture_gain), JointLimitAvoidance(limits)]
        if self.singularity_avoidance:
            tasks.append(SingularityAvoidance(kinematics))
        scheme = create(self.scheme, desired, self._law())
        scheme.smoothing = self.smoothing
        return Servo(
            scheme,
            Resolver(kinematics, limits, tasks, ResolverSettings(elbow=self.elbow)),
            ServoSettings(
                start=self.start_joints(),
                pitch=kinematics.pitch(desired.joints),
                pitch_gain=self.pitch_gain,
                hold=self.hold,
                lead=self.lead,
            ),
        )

    def _law(self) -> Law:
        if self.law == "adaptive":
            return Adaptive(self.gain_zero, self.gain_infinity, self.gain_slope)
        return Proportional(self.gain, self.ramp)

    def _limits(self) -> JointLimits:
        try:
            return JointLimits(self.lower, self.upper, self.max_velocity)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error


def _convert(name: str, value: Any, default: Any) -> Any:
    """The value in the type of the default; numbers must be finite."""
    if name == "start":
        # roslaunch turns start:=2016 into an integer.
        if isinstance(value, int) and not isinstance(value, bool):
            return str(value)
        if isinstance(value, str):
            return value
        return _six(name, value)
    if name == "desired" and isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if isinstance(default, tuple):
        return _six(name, value)
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value
    elif isinstance(default, int):
        if isinstance(value, int) and not isinstance(value, bool):
            return value
    elif isinstance(default, float):
        if _is_number(value):
            return float(value)
    elif isinstance(value, str) and value:
        return value
    kind = {bool: "true or false", int: "an integer", float: "a finite number", str: "a string"}
    raise ConfigurationError(f"parameter ~{name} is {value!r}, must be {kind[type(default)]}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)


def _six(name: str, value: Any) -> tuple[float, ...]:
    if not (
        isinstance(value, list | tuple) and len(value) == 6 and all(_is_number(v) for v in value)
    ):
        raise ConfigurationError(
            f"parameter ~{name} is {value!r}, must be six finite numbers in the order "
            f"{', '.join(JOINT_NAMES)}"
        )
    return tuple(float(v) for v in value)
