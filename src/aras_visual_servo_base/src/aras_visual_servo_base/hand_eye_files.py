"""Reader of hand-eye calibrations: the pose of a camera frame in the link that carries it.

The reader detects the format from the content of the file. It supports:

- a 4x4 homogeneous matrix as text (numpy.savetxt), in YAML or in OpenCV's FileStorage;
- the result of OpenCV's calibrateHandEye, R and t (`R_cam2gripper`, `t_cam2gripper`), in YAML or in
  a FileStorage; R may be a rotation vector;
- ViSP's eMc, as a pose vector (t, theta u) in text or YAML, or as a file of
  vpXmlParserHomogeneousMatrix;
- the launch file of moveit_calibration (ROS 1 or 2) with a static_transform_publisher;
- files of easy_handeye, and a geometry_msgs/TransformStamped, in YAML.

ViSP and ROS use metres. In the other formats the unit is not known. Lengths up to
LONGEST_TRANSLATION are then assumed to be in metres; for larger ones, `units` must be set.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .errors import DescriptionError, HandEyeFileError
from .names import suggest
from .opencv_files import read_storage
from .poses import LENGTH_UNITS, rotation_from_quaternion, rotation_from_rpy
from .safe_xml import parse
from .setting_values import as_number, format_value
from .yaml_files import parse_yaml, read_text

# Largest accepted distance from a camera to the link that carries it, m.
LONGEST_TRANSLATION = 2.0
# If `units` is set, smallest accepted distance, other than 0, from a camera to the link that
# carries it, m. A smaller distance indicates that `units` is wrong.
SHORTEST_TRANSLATION = 1e-3
# Largest absolute element of R R^T - I of a rotation R. It is not zero, because numbers in files
# are rounded.
ROTATION_TOLERANCE = 1e-3
# Name of the translation for each name of a rotation, in lower case.
PAIRS = {"r": "t", "rot": "trans", "rotation": "translation", "rvec": "tvec"}
# Name of a rotation with or without the names of two frames, such as r_cam2gripper.
ROTATION_NAME = re.compile(rf"({'|'.join(PAIRS)})(_?\w+?(?:2|_to_)\w+)?")
# Name of a matrix that maps coordinates to the camera frame, such as gripper2cam.
INVERSE_NAME = re.compile(r"(2|_to_|to)(cam|camera|optical)\b")
PUBLISHER_FLAGS = {"x", "y", "z", "qx", "qy", "qz", "qw", "roll", "pitch", "yaw", "frame-id",
                   "child-frame-id", "ros-args"}  # fmt: skip
PUBLISHER = "static_transform_publisher"


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """Pose of a camera frame in the link that carries the camera.

    Attributes:
        link_T_camera: (4, 4) pose of the camera frame in the link, m.
        link: link that carries the camera; '' if the file does not name it.
        frame: name of the camera frame; '' for the optical frame (z forward, x right, y down).
    """

    link_T_camera: np.ndarray
    link: str = ""
    frame: str = ""


def read_hand_eye(path: str | Path, units: str = "") -> HandEyeCalibration:
    """Read a hand-eye calibration in one of the formats that the module lists.

    Args:
        units: unit of the lengths in the file: m, cm or mm; '' for the unit that the file states,
            or m if it states none.

    Raises:
        HandEyeFileError: the file is invalid; the message names the file, the field and what is
            expected.
    """
    path = Path(path).expanduser()
    text = read_text(path, HandEyeFileError)
    match = re.search(r"^\s*<?units?\s*[:>]\s*[\"']?(\w+)", text, re.MULTILINE)
    stated_units = match[1] if match else ""
    if text.lstrip().startswith("<"):
        found = _read_xml(text, path)
    elif PUBLISHER in text:
        arguments = re.findall(r"""["']([^"']*)["']""", _find_publisher_text(text))
        found = _read_publisher_arguments(arguments, path)
    elif (rows := _parse_rows(text)) is not None:
        found = HandEyeCalibration(_pose_from_rows(rows, str(path)))
    elif text.startswith("%YAML") or re.search("opencv-(nd-)?matrix", text):
        found = _read_opencv(text, path)
    else:
        data = parse_yaml(text, str(path), HandEyeFileError)
        found = _read_yaml(data, path)
        if isinstance(data, Mapping):
            stated_units = str(data.get("units", data.get("unit", "")))
    pose = _convert_to_metres(found.link_T_camera, units or stated_units, path)
    return replace(found, link_T_camera=pose)


def _convert_to_metres(pose: np.ndarray, units: str, path: Path) -> np.ndarray:
    if units and units not in LENGTH_UNITS:
        raise HandEyeFileError(f"{path}: units are {format_value(units)}, must be m, cm or mm")
    t = pose[:3, 3] * LENGTH_UNITS.get(units, 1.0)
    length, written = float(np.linalg.norm(t)), np.round(pose[:3, 3], 6).tolist()
    if length > LONGEST_TRANSLATION:
        remedy = "; if it is in mm or cm, set units, otherwise correct the translation"
        if units:
            remedy = f" in {units}; correct the translation, or units"
        raise HandEyeFileError(
            f"{path}: the translation {written} is {length:.4g} m long{remedy}"
        )
    if units and 0.0 < length < SHORTEST_TRANSLATION:
        raise HandEyeFileError(f"{path}: the translation {written} is only {length:.3g} m long in "
                               f"{units}; correct units")  # fmt: skip
    converted = pose.copy()
    converted[:3, 3] = t
    return converted


def _parse_rows(text: str) -> list[list[float]] | None:
    """Return the numbers in each line of a text; None if it contains anything but numbers."""
    lines = [re.split("[#%]", line)[0].strip(" \t[],;") for line in text.splitlines()]
    try:
        return [[float(word) for word in re.split(r"[\s,;]+", line)]
                for line in lines if line] or None  # fmt: skip
    except ValueError:
        return None


def _pose_from_rows(rows: Any, where: str) -> np.ndarray:
    """Return a pose (4, 4) from a 4x4 matrix, its 16 numbers in one row, or ViSP's pose vector."""
    if isinstance(rows, list | tuple) and not any(isinstance(row, list | tuple) for row in rows):
        rows = [rows]
    numbers = _flatten(rows, where)
    shape = [len(_flatten(row, where)) for row in rows]
    if shape in ([4] * 4, [16]):
        matrix = np.reshape(numbers, (4, 4))
        last = [0.0, 0.0, 0.0, 1.0]
        if not np.array_equal(matrix[3], last):
            hint = "; transpose it" if np.array_equal(matrix[:, 3], last) else ""
            raise HandEyeFileError(f"{where}: the last row of the matrix is {matrix[3].tolist()}, "
                                   f"must be [0, 0, 0, 1]{hint}")  # fmt: skip
        return _make_pose(matrix[:3, :3], matrix[:3, 3], where)
    if shape in ([6], [1] * 6):
        R = _rotation_from_vector(numbers[3:], f"{where}: theta u")
        return _make_pose(R, numbers[:3], where)
    raise HandEyeFileError(f"{where} has {len(numbers)} numbers in {len(shape)} rows; give a 4x4 "
                           "matrix, or the 6 numbers of ViSP's pose vector (t, theta u), and check "
                           "that the file is complete")  # fmt: skip


def _rotation_from_vector(vector: Sequence[float], where: str) -> np.ndarray:
    """Return the rotation matrix R (3, 3) of a rotation vector, rad."""
    import cv2

    turn = np.asarray(vector, float)
    if np.linalg.norm(turn) > 2.0 * math.pi:
        raise HandEyeFileError(
            f"{where} is {turn.tolist()}, which looks like degrees; give it in rad"
        )
    return cv2.Rodrigues(turn)[0]


def _rotation_from_quaternion(q: Sequence[float], where: str) -> np.ndarray:
    length = math.sqrt(sum(part * part for part in q))
    if not abs(length - 1.0) < 1e-2:
        raise HandEyeFileError(
            f"{where} {list(q)} has the norm {length:.4g}, must be 1; correct it"
        )
    return np.array(rotation_from_quaternion(tuple(part / length for part in q)))


def _make_pose(R: np.ndarray, t: Sequence[float], where: str) -> np.ndarray:
    """Return the pose (4, 4) of R and t. Rounding errors of R are removed by orthonormalisation."""
    R, t = np.asarray(R, float), np.asarray(t, float).ravel()
    if not (np.isfinite(R).all() and np.isfinite(t).all()) or t.shape != (3,):
        raise HandEyeFileError(f"{where}: the translation is {t.tolist()}, must be three finite "
                               "numbers")  # fmt: skip
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > ROTATION_TOLERANCE or np.linalg.det(R) < 0.0:
        raise HandEyeFileError(
            f"{where}: R {np.round(R, 4).tolist()} is not a rotation matrix: the "
            f"largest element of R R' - I is {off:.2g}, must be at most "
            f"{ROTATION_TOLERANCE:g}, and det R is {np.linalg.det(R):.3g}, must be "
            "1; correct it"
        )
    U, _, V = np.linalg.svd(R)
    pose = np.eye(4)
    pose[:3, :3] = R if off < 1e-12 else U @ V
    pose[:3, 3] = t
    return pose


def _read_xml(text: str, path: Path) -> HandEyeCalibration:
    try:
        root = parse(text, str(path))
    except DescriptionError as error:
        raise HandEyeFileError(f"{error}: check that the file is complete") from None
    if root.tag == "launch":
        nodes = [node for node in root.iter("node") if node.get("type") == PUBLISHER]
        if len(nodes) != 1:
            raise HandEyeFileError(f"{path} has {len(nodes)} nodes of the type {PUBLISHER}; give a "
                                   "launch file with exactly one")  # fmt: skip
        return _read_publisher_arguments(nodes[0].get("args", "").split(), path)
    if root.tag == "opencv_storage":
        return _read_opencv(text, path)
    values = root.findall("homogeneous_transformation/values")
    if len(values) != 1:
        raise HandEyeFileError(
            f"{path} has {len(values)} <homogeneous_transformation> with <values>; "
            "give a file with exactly one"
        )
    numbers = []
    for tag in ("tx", "ty", "tz", "theta_ux", "theta_uy", "theta_uz"):
        text = values[0].findtext(tag)
        if (number := _parse_float(text)) is None:
            raise HandEyeFileError(
                f"{path}: <{tag}> is {format_value(text)}, must be a finite number"
            )
        numbers.append(number)
    return HandEyeCalibration(_pose_from_rows(numbers, str(path)))


def _read_publisher_arguments(arguments: Sequence[str], path: Path) -> HandEyeCalibration:
    """Read the arguments of static_transform_publisher.

    The arguments are x y z, then yaw pitch roll or a quaternion, then the link and the camera
    frame. In ROS 2, they may be given as flags, such as --x 0.1.
    """
    where = f"{path}: {PUBLISHER}"
    if any(word.startswith("--") for word in arguments):
        pairs = zip(arguments, arguments[1:], strict=False)
        given = {key.lstrip("-"): value for key, value in pairs if key.startswith("--")}
        unknown = sorted(set(given) - PUBLISHER_FLAGS)
        if unknown:
            raise HandEyeFileError(f"{where} has the flag {format_value(unknown[0])}: "
                                   f"{suggest(unknown[0], sorted(PUBLISHER_FLAGS))}")  # fmt: skip
        link, frame = given.get("frame-id", ""), given.get("child-frame-id", "")
        quaternion = any(key in given for key in ("qx", "qy", "qz", "qw"))
        keys = ("qx", "qy", "qz", "qw") if quaternion else ("yaw", "pitch", "roll")
        arguments = [given.get(key, "1" if key == "qw" and not quaternion else "0")
                 for key in ("x", "y", "z", *keys)]  # fmt: skip
        rest: Sequence[str] = ()
    else:
        words = [i for i, word in enumerate(arguments) if _parse_float(word) is None]
        count = words[0] if words else len(arguments)
        link, frame, *rest = (*arguments[count:], "", "")
        # In ROS 1, the last argument of static_transform_publisher is a number, the period of the
        # messages. It is dropped here.
        rest = [word for word in rest if word and _parse_float(word) is None]
        arguments = arguments[:count]
    numbers = [_parse_float(word) for word in arguments]
    if len(numbers) not in (6, 7) or None in numbers or not (link and frame) or rest:
        frames = ", ".join(map(format_value, (link, frame, *rest)))
        raise HandEyeFileError(
            f"{where} has {len(numbers)} numbers and the frames {frames}; give x y z qx qy qz qw "
            "(or x y z yaw pitch roll), then two frames"
        )
    if len(numbers) == 7:
        R = _rotation_from_quaternion(numbers[3:], f"{where}: the quaternion")
    else:
        yaw, pitch, roll = numbers[3:]
        if max(map(abs, numbers[3:])) > 2.0 * math.pi:
            raise HandEyeFileError(
                f"{where}: yaw, pitch, roll {numbers[3:]} look like degrees; give rad"
            )
        R = rotation_from_rpy(roll, pitch, yaw)
    pose = _make_pose(R, numbers[:3], where)
    return HandEyeCalibration(pose, link.lstrip("/"), frame.lstrip("/"))


def _find_publisher_text(text: str) -> str:
    """Return the arguments of static_transform_publisher in the text of a Python launch file."""
    code = re.sub(r"#.*", "", text)
    after = code[code.index(PUBLISHER) + len(PUBLISHER) :] if PUBLISHER in code else ""
    inside, closed, _ = after[max(after.find("arguments"), 0) :].partition("]")
    return inside if closed else ""


def _read_yaml(data: Any, path: Path) -> HandEyeCalibration:
    if not isinstance(data, Mapping):
        return HandEyeCalibration(_pose_from_rows(data, str(path)))
    # a YAML file of ViSP contains an array as rows, cols and data
    if "rows" in data and "data" in data:
        numbers = _flatten(data["data"], f"{path}: data")
        shape = [data.get(key) for key in ("rows", "cols")]
        if not all(isinstance(side, int) for side in shape):
            raise HandEyeFileError(f"{path}: rows and cols are {shape}, must be whole numbers")
        if len(numbers) != shape[0] * shape[1]:
            raise HandEyeFileError(
                f"{path}: data has {len(numbers)} numbers, but rows and cols are {shape[0]} and "
                f"{shape[1]}: check that the file is complete"
            )
        return HandEyeCalibration(_pose_from_rows(np.reshape(numbers, shape).tolist(), str(path)))
    for key in ("transformation", "transform"):
        if isinstance(data.get(key), Mapping):
            return _read_ros(data, data[key], f"{path}: {key}")
    if isinstance(data.get("translation"), Mapping):
        return _read_ros(data, data, str(path))
    return HandEyeCalibration(_read_entries(data, path))


def _read_ros(data: Mapping[str, Any], entry: Mapping[str, Any], where: str) -> HandEyeCalibration:
    """Return the calibration in `entry`, from easy_handeye or a geometry_msgs/Transform.

    `data` is the content of the file, which may name the link and the camera frame.
    """
    parts = {key: entry.get(key) for key in ("x", "y", "z", "qx", "qy", "qz", "qw")}
    for key, names in (("translation", ("x", "y", "z")), ("rotation", ("qx", "qy", "qz", "qw"))):
        if isinstance(entry.get(key), Mapping):
            parts |= {name: entry[key].get(name.removeprefix("q")) for name in names}
    for name, value in parts.items():
        if as_number(value) is None:
            raise HandEyeFileError(
                f"{where}: {name} is {format_value(value)}, must be a finite number"
            )
    x, y, z, *q = (float(as_number(value)) for value in parts.values())
    matrix = _make_pose(_rotation_from_quaternion(q, f"{where}: the quaternion"), (x, y, z), where)
    of = data.get("parameters") if isinstance(data.get("parameters"), Mapping) else data
    header = data.get("header") if isinstance(data.get("header"), Mapping) else {}
    in_hand = of.get("eye_on_hand", of.get("calibration_type", "eye_in_hand") != "eye_on_base")
    link = of.get("robot_effector_frame" if in_hand else "robot_base_frame")
    frame = of.get("tracking_base_frame") or data.get("child_frame_id")
    names = (str(name or "").lstrip("/") for name in (link or header.get("frame_id"), frame))
    return HandEyeCalibration(matrix, *names)


def _read_opencv(text: str, path: Path) -> HandEyeCalibration:
    """Read an OpenCV FileStorage that contains a 4x4 matrix, or R and t."""
    entries = read_storage(text, path, HandEyeFileError)
    data = {name: value.tolist() for name, value in entries.items()
            if isinstance(value, np.ndarray)}  # fmt: skip
    return HandEyeCalibration(_read_entries(data, path))


def _read_entries(data: Mapping[str, Any], path: Path) -> np.ndarray:
    """Return the pose from a mapping with a 4x4 matrix, or with R and t.

    The name of the matrix is arbitrary. R and t must have names that match ROTATION_NAME and PAIRS.
    """
    lists = {str(key): value for key, value in data.items() if isinstance(value, list | tuple)}
    numbers = {name: _flatten(value, f"{path}: {name}") for name, value in lists.items()}
    matrices = [name for name, values in numbers.items() if len(values) == 16]
    rotations = [name for name in numbers if ROTATION_NAME.fullmatch(name.lower())]
    if len(matrices) == 1:
        name = matrices[0]
        pose = _pose_from_rows(lists[name], f"{path}: {name}")
    elif rotations:
        name = rotations[0]
        where, turn = f"{path}: {name}", numbers[name]
        kind, frames = ROTATION_NAME.fullmatch(name.lower()).groups("")
        other = PAIRS[kind] + frames
        t = next((values for key, values in numbers.items() if key.lower() == other), None)
        if t is None:
            raise HandEyeFileError(
                f"{path} has the rotation {name}, but not the translation {other}; add it"
            )
        if len(turn) not in (3, 9):
            raise HandEyeFileError(f"{where} has {len(turn)} numbers, must have 9 (rotation "
                                   "matrix) or 3 (rotation vector, rad)")  # fmt: skip
        R = np.reshape(turn, (3, 3)) if len(turn) == 9 else _rotation_from_vector(turn, where)
        pose = _make_pose(R, t, where)
    else:
        raise HandEyeFileError(
            f"{path} contains only {', '.join(map(str, data)) or 'nothing'}; add a 4x4 "
            "matrix, or R and t (such as R_cam2gripper and t_cam2gripper)"
        )
    return np.linalg.inv(pose) if INVERSE_NAME.search(name.lower()) else pose


def _flatten(value: Any, where: str) -> list[float]:
    """Return the numbers of a nested list, after checking that they are finite."""
    if isinstance(value, list | tuple):
        return [number for part in value for number in _flatten(part, where)]
    number = as_number(value)
    if number is None:
        raise HandEyeFileError(
            f"{where}: {format_value(value)} is not a finite number: check that the file is "
            "complete"
        )
    return [number]


def _parse_float(text: str | None) -> float | None:
    try:
        number = float(text)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
