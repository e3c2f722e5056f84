"""The pose to reach and what the camera sees there, from a YAML file.

    joints: {gantry: 0.0, J1: 0.0, J2: 0.0, J3: 0.0, J5: 0.0, J6: 0.0}   # m, rad
    depth: 0.1917                # of the target along the optical axis there, m
    moments: {order: 3, m: [...], mu: [...]}    # normalised coordinates, as in ImageMoments
    kernel: {width: 320, height: 240, K: [9 numbers], features: [4 numbers]}    # optional
    mounting: {xyz: [0, 0, 0.0334], rpy: [0.0008, 0.0, 1.5692]}    # optional, m and rad

Moments in normalised metric coordinates do not depend on the lens; the kernel features count
pixels and hold for one camera only, which is why its intrinsics stand beside them. All of them
depend on where the camera sits on the flange: `mounting` is the pose of its optical frame in link6
(roll, pitch, yaw about fixed axes); a file without it means the robot's own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .errors import ConfigurationError
from .kinematics import JOINT_NAMES, MOUNTING, Kinematics, transform
from .mounting import to_xyz_rpy


@dataclass(frozen=True)
class DesiredKernel:
    """Kernel features (4,) at the desired pose, seen by the camera with these intrinsics."""

    width: int
    height: int
    K: np.ndarray
    features: np.ndarray


@dataclass(frozen=True)
class Desired:
    """What the servo loop drives the robot to.

    Attributes:
        name: of the file, for messages.
        joints: (6,) a posture whose camera pose is the desired one, m and rad.
        depth: Z* of the target plane along the optical axis, m.
        order: highest i + j of the moments.
        m, mu: raw and centred moments in the order of the ImageMoments message.
        kernel: the kernel features, or None when they have not been taught.
        mounting: `flange_T_optical` (4, 4) of the camera that saw this.
    """

    name: str
    joints: np.ndarray
    depth: float
    order: int
    m: np.ndarray
    mu: np.ndarray
    kernel: DesiredKernel | None = None
    mounting: np.ndarray = field(default_factory=lambda: MOUNTING)

    @property
    def camera_pose(self) -> np.ndarray:
        """`world_T_optical` (4, 4) at the goal."""
        return Kinematics(mounting=self.mounting).pose(self.joints)

    @classmethod
    def from_mapping(cls, data: Any, name: str) -> "Desired":
        """Check and convert what the YAML file holds.

        Raises:
            ConfigurationError: naming the key that is missing or wrong.
        """
        if not isinstance(data, Mapping):
            raise ConfigurationError(f"{name}: expected keys 'joints', 'depth' and 'moments'")
        known = {"joints", "depth", "moments", "kernel", "mounting"}
        for key in data:
            if key not in known:
                raise ConfigurationError(f"{name}: unknown key '{key}', known are {sorted(known)}")
        joints = _entry(data, "joints", name)
        if not isinstance(joints, Mapping) or set(joints) != set(JOINT_NAMES):
            raise ConfigurationError(f"{name}: 'joints' must name exactly {', '.join(JOINT_NAMES)}")
        moments = _entry(data, "moments", name)
        order = moments.get("order") if isinstance(moments, Mapping) else None
        if not isinstance(order, int) or isinstance(order, bool) or order < 2:
            raise ConfigurationError(f"{name}: 'moments.order' must be an integer of at least 2")
        count = (order + 1) * (order + 2) // 2
        m = _numbers(_entry(moments, "m", name), count, f"{name}: 'moments.m'")
        mu = _numbers(_entry(moments, "mu", name), count, f"{name}: 'moments.mu'")
        depth = _numbers([_entry(data, "depth", name)], 1, f"{name}: 'depth'")[0]
        if depth <= 0.0 or m[0] <= 0.0:
            raise ConfigurationError(f"{name}: 'depth' and the area m00 must be above 0")
        return cls(
            name=name,
            joints=_numbers([joints[j] for j in JOINT_NAMES], 6, f"{name}: 'joints'"),
            depth=float(depth),
            order=order,
            m=m,
            mu=mu,
            kernel=_kernel(data.get("kernel"), name),
            mounting=_mounting(data.get("mounting"), name),
        )

    @classmethod
    def load(cls, path: str | Path) -> "Desired":
        """Read a file.

        Raises:
            ConfigurationError: the file cannot be read, is not YAML, or a key is wrong.
        """
        path = Path(path)
        try:
            data = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigurationError(f"cannot read the desired features {path}: {error}") from error
        except yaml.YAMLError as error:
            place = " ".join(str(error).split())
            raise ConfigurationError(f"{path} is not valid YAML: {place}") from error
        return cls.from_mapping(data, path.name)

    def to_yaml(self, heading: str) -> str:
        """The file's text; heading becomes a comment at its top."""
        data: dict[str, Any] = {
            "joints": {n: float(v) for n, v in zip(JOINT_NAMES, self.joints, strict=True)},
            "depth": float(self.depth),
            "moments": {
                "order": self.order,
                "m": [float(value) for value in self.m],
                "mu": [float(value) for value in self.mu],
            },
        }
        if self.kernel is not None:
            data["kernel"] = {
                "width": self.kernel.width,
                "height": self.kernel.height,
                "K": [float(value) for value in np.ravel(self.kernel.K)],
                "features": [float(value) for value in self.kernel.features],
            }
        xyz, rpy = to_xyz_rpy(self.mounting)
        data["mounting"] = {"xyz": xyz, "rpy": rpy}
        comment = "".join(f"# {line}\n" for line in heading.splitlines())
        return comment + yaml.safe_dump(data, sort_keys=False, width=96)


def _entry(data: Mapping[str, Any], key: str, name: str) -> Any:
    if key not in data:
        raise ConfigurationError(f"{name}: key '{key}' is missing")
    return data[key]


def _numbers(values: Any, count: int, where: str) -> np.ndarray:
    wrong = ConfigurationError(f"{where} must be {count} finite number(s)")
    if not isinstance(values, list | tuple) or len(values) != count:
        raise wrong
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
        raise wrong
    array = np.array(values, float)
    if not np.isfinite(array).all():
        raise wrong
    array.setflags(write=False)
    return array


def _kernel(data: Any, name: str) -> DesiredKernel | None:
    if data is None:
        return None
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{name}: 'kernel' must hold width, height, K and features")
    size = _numbers([data.get("width"), data.get("height")], 2, f"{name}: 'kernel' width, height")
    return DesiredKernel(
        width=int(size[0]),
        height=int(size[1]),
        K=_numbers(data.get("K"), 9, f"{name}: 'kernel.K'").reshape(3, 3),
        features=_numbers(data.get("features"), 4, f"{name}: 'kernel.features'"),
    )


def _mounting(data: Any, name: str) -> np.ndarray:
    if data is None:
        return MOUNTING
    if not isinstance(data, Mapping) or set(data) != {"xyz", "rpy"}:
        raise ConfigurationError(f"{name}: 'mounting' must hold xyz and rpy")
    parts = [_numbers(data[key], 3, f"{name}: 'mounting.{key}'") for key in ("xyz", "rpy")]
    return transform(*parts)
