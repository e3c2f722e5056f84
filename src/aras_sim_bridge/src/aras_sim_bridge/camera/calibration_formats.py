"""Readers of the formats of calibration files.

If the text is in another format, a reader returns None. Otherwise it returns a dict that maps each
camera's name to a function without arguments, which returns the camera's Calibration. Camera
matrices and distortion coefficients are not converted, because all these formats measure pixel
coordinates from the centre of the first pixel and have OpenCV's order of the coefficients.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.names import find_nearest, suggest
from aras_visual_servo_base.opencv_files import read_storage
from aras_visual_servo_base.setting_values import format_value
from aras_visual_servo_base.yaml_files import parse_yaml

from ..errors import CameraError, DescriptionError
from .calibration import Calibration, check_finite, find_distortion_model

CameraReaders = dict[str, Callable[[], Calibration]]
Reader = Callable[[str, str], CameraReaders | None]
NAME = "camera"  # name of the camera if the calibration file gives none
# For OpenCV's files: names of the camera matrix (MATRICES) and of the distortion (DISTORTIONS), in
# lower case and without underscores. Each name is mapped to the number of the camera in a stereo
# pair, '1' or '2', or to '' for a single camera.
MATRICES = {"cameramatrix": "", "intrinsicmatrix": "", "intrinsics": "", "cameraintrinsic": "",
            "mtx": "", "k": "", "m1": "1", "m2": "2", "cameramatrix1": "1", "cameramatrix2": "2",
            "k1": "1", "k2": "2"}  # fmt: skip
DISTORTIONS = {"distortioncoefficients": "", "distcoeffs": "", "distcoeff": "", "dist": "",
               "distortion": "", "distortioncoeffs": "", "d": "", "d1": "1", "d2": "2",
               "distcoeffs1": "1", "distcoeffs2": "2"}  # fmt: skip
# Names by which ViSP's files identify the three camera models.
VISP = "perspectiveProjWithoutDistortion"
VISP_DISTORTED = "perspectiveProjWithDistortion"
VISP_FISHEYE = "ProjWithKannalaBrandtDistortion"


def read_ros(text: str, path: str) -> CameraReaders | None:
    """Read a camera_info file of camera_calibration_parsers, or a message printed by rostopic."""
    data = _parse_mapping(text, path)
    if data is None:
        return None
    if {"K", "D"} <= set(data) and "width" in data:
        return {NAME: partial(_read_ros_message, data, path)}
    matrix, distortion = data.get("camera_matrix"), data.get("distortion_coefficients")
    shaped = [isinstance(one, Mapping) and ("rows" in one or "data" in one)
              for one in (matrix, distortion)]  # fmt: skip
    if not (any(shaped) or {"image_width", "image_height", "camera_name"} & set(data)):
        return None
    return {NAME: partial(_read_ros_file, data, path, text.endswith("\n"))}


def _read_ros_file(data: Mapping[str, Any], path: str, whole: bool) -> Calibration:
    size = [_read_size(data, key, path) for key in ("image_width", "image_height")]
    K = _read_ros_matrix(data, "camera_matrix", path, (3, 3))
    # Files of old ROS versions do not contain the key distortion_model.
    model = data.get("distortion_model")
    model = None if model is None else find_distortion_model(model, path)
    D = _read_ros_matrix(data, "distortion_coefficients", path, None)
    more = [key for key in ("rectification_matrix", "projection_matrix") if key in data]
    if len(more) == 1 or not (more or whole):
        raise CameraError(f"{path}: {'projection' if more else 'rectification'}_matrix is missing, "
                          "so the file is incomplete; copy it again")  # fmt: skip
    R = _read_ros_matrix(data, "rectification_matrix", path, (3, 3)) if more else None
    P = _read_ros_matrix(data, "projection_matrix", path, (3, 4)) if more else None
    return Calibration(path, *size, K, model, D, R, P)


def _read_ros_message(data: Mapping[str, Any], path: str) -> Calibration:
    size = [_read_size(data, key, path) for key in ("width", "height")]
    of = {key: check_finite(_read_entry(data, key, path), f"{path}: {key}", counts)
          for key, counts in (("K", (9,)), ("D", ()), ("R", (9,)), ("P", (12,)))}  # fmt: skip
    model = find_distortion_model(_read_entry(data, "distortion_model", path), path)
    return Calibration(path, *size, of["K"], model, of["D"], of["R"], of["P"])


def _read_ros_matrix(
    data: Mapping[str, Any], key: str, path: str, shape: tuple[int, int] | None
) -> tuple[float, ...]:
    entry, where = _read_entry(data, key, path), f"{path}: {key}"
    if not isinstance(entry, Mapping):
        raise CameraError(
            f"{where} is {format_value(entry)}, must be a mapping of rows, cols and data"
        )
    found = tuple(_read_size(entry, side, where) for side in ("rows", "cols"))
    numbers = check_finite(_read_entry(entry, "data", where), f"{where}.data")
    if found[0] * found[1] != len(numbers):
        raise CameraError(f"{where} has {found[0]} rows and {found[1]} cols, but its data have "
                          f"{len(numbers)} numbers: correct rows and cols, or data")  # fmt: skip
    if shape is not None and found != shape:
        raise CameraError(f"{where} has {found[0]} rows and {found[1]} cols, must have {shape[0]} "
                          f"rows and {shape[1]} cols")  # fmt: skip
    return numbers


def read_ros_ini(text: str, path: str) -> CameraReaders:
    """Read an .ini file of camera_calibration_parsers, with sections [image] and [NAME]."""
    sections = re.split(r"^\[(.*)\]\s*$", text, flags=re.MULTILINE)[1:]
    known = {name: body for name, body in zip(sections[::2], sections[1::2], strict=True)
             if name not in ("image", "externals")}  # fmt: skip
    size = dict(zip(sections[::2], sections[1::2], strict=True)).get("image", "")
    if not known:
        raise CameraError(f"{path}: the section of the camera is missing after [image]: the file "
                          "is incomplete; copy it again")  # fmt: skip
    return {name: partial(_read_ini_camera, size, body, path, name) for name, body in known.items()}


def _read_ini_camera(size: str, body: str, path: str, name: str) -> Calibration:
    def read_numbers(text: str, field: str, counts: tuple[int, ...]) -> tuple[float, ...]:
        where = f"{path}: {field}"
        found = re.search(rf"^{field}[ \t]*\n((?:[^a-z\[\n#]*(?:\n|$))*)", text, re.MULTILINE)
        if found is None:
            raise CameraError(f"{where} is missing, so the file is incomplete; copy it again")
        try:
            return check_finite([float(word) for word in found[1].split()], where, counts)
        except ValueError:
            raise CameraError(
                f"{where} is {format_value(found[1].strip())}, must be numbers"
            ) from None

    width, height = (read_numbers(size, side, (1,))[0] for side in ("width", "height"))
    K = read_numbers(body, "camera matrix", (9,))
    D = read_numbers(body, "distortion", (4, 5, 8, 12, 14))
    R, P = read_numbers(body, "rectification", (9,)), read_numbers(body, "projection", (12,))
    if width != int(width) or height != int(height):
        raise CameraError(f"{path}: width and height are {width:g} and {height:g}, must be whole "
                          "numbers")  # fmt: skip
    return Calibration(path, int(width), int(height), K, None, D, R, P)


def read_opencv(text: str, path: str) -> CameraReaders | None:
    """Read an OpenCV FileStorage, which may be YAML, XML or JSON."""
    if text.lstrip().startswith("<") and _parse_xml(text, path).tag != "opencv_storage":
        return None
    found = read_storage(text, path, CameraError)
    plain = {name.lower().replace("_", ""): value for name, value in found.items()}
    cameras = {
        of or NAME: partial(_read_opencv_camera, plain, key, of, path)
        for key, of in MATRICES.items() if isinstance(plain.get(key), np.ndarray)
    }  # fmt: skip
    for key in ("camera", "camera1", "camera2"):
        if f"{key}.fx" in plain:
            cameras[key[6:] or NAME] = partial(_read_orb_slam_camera, plain, f"{key}.", path)
    if not cameras:
        raise CameraError(f"{path}: camera_matrix is missing: add it (the file contains "
                          f"{', '.join(found) or 'nothing'})")  # fmt: skip
    return cameras


def _read_opencv_camera(plain: Mapping[str, Any], key: str, of: str, path: str) -> Calibration:
    K = plain[key]
    if K.shape != (3, 3):
        raise CameraError(f"{path}: camera_matrix has the shape {K.shape}, must have (3, 3)")
    distortion = [name for name, number in DISTORTIONS.items() if number == of and name in plain]
    if not distortion:
        raise CameraError(f"{path}: distortion_coefficients are missing: add them (zeros for a "
                          "camera without distortion)")  # fmt: skip
    D = plain[distortion[0]]
    D = [] if D is None else np.ravel(D).tolist()
    size = plain.get("imagesize") or plain.get("imgsize") or plain.get("size")
    if isinstance(size, np.ndarray):
        size = size.ravel().tolist()
    sides = size if isinstance(size, list) and len(size) == 2 else [
        plain.get(f"image{side}", plain.get(side)) for side in ("width", "height")]  # fmt: skip
    if (sides[0] is None) != (sides[1] is None):
        missing = "image_width" if sides[0] is None else "image_height"
        raise CameraError(f"{path}: {missing} is missing: add it, in px")
    for name, side in zip(("image_width", "image_height"), sides, strict=True):
        if side is not None and (not isinstance(side, int | float) or side != int(side)):
            raise CameraError(f"{path}: {name} is {format_value(side)}, must be a whole number")
    sides = [None if side is None else int(side) for side in sides]
    model = "equidistant" if plain.get("fisheyemodel") else None
    K = check_finite(K.ravel().tolist(), f"{path}: camera_matrix", (9,))
    return Calibration(path, *sides, K, model, check_finite(D, f"{path}: distortion_coefficients"))


def _read_orb_slam_camera(plain: Mapping[str, Any], key: str, path: str) -> Calibration:
    """Read a camera of ORB-SLAM 2 or 3, whose keys start with `key`."""
    def read_numbers(names: str) -> tuple[float, ...]:
        values = [plain.get(key + name, 0.0 if name == "k3" else None) for name in names.split()]
        for name, value in zip(names.split(), values, strict=True):
            if not isinstance(value, float):
                raise CameraError(f"{path}: {key.capitalize()}{name} is missing: add it")
        return check_finite(values, f"{path}: {key.capitalize()}{names.partition(' ')[0]}")

    fisheye = plain.get("camera.type") == "KannalaBrandt8"
    fx, fy, cx, cy = read_numbers("fx fy cx cy")
    D = read_numbers("k1 k2 k3 k4" if fisheye else "k1 k2 p1 p2 k3")
    sides = [plain.get(f"camera.{side}") for side in ("width", "height")]
    sides = [None if side is None else int(side) for side in sides]
    return Calibration(path, *sides, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
                       "equidistant" if fisheye else "plumb_bob", D)  # fmt: skip


def read_camodocal(text: str, path: str) -> CameraReaders | None:
    """Read a file of CamOdoCal, as VINS-Fusion and others use it."""
    data = _parse_mapping(text, path)
    if data is None or "model_type" not in data:
        return None
    return {NAME: partial(_read_camodocal_camera, data, path)}


def _read_camodocal_camera(data: Mapping[str, Any], path: str) -> Calibration:
    def read_numbers(group: str, names: str) -> tuple[float, ...]:
        where = f"{path}: {group}"
        block = _read_entry(data, group, path)
        if not isinstance(block, Mapping):
            raise CameraError(f"{where} is {format_value(block)}, must be a mapping of {names}")
        return check_finite([_read_entry(block, name, where) for name in names.split()], where)

    kind = data["model_type"]
    sides = [_read_size(data, key, path) for key in ("image_width", "image_height")]
    if kind == "PINHOLE":
        fx, fy, cx, cy = read_numbers("projection_parameters", "fx fy cx cy")
        model, D = "plumb_bob", read_numbers("distortion_parameters", "k1 k2 p1 p2")
    elif kind == "KANNALA_BRANDT":
        *D, fx, fy, cx, cy = read_numbers("projection_parameters", "k2 k3 k4 k5 mu mv u0 v0")
        model = "equidistant"
    else:
        raise CameraError(f"{path}: model_type {format_value(kind)} is not supported: calibrate "
                          "with PINHOLE or KANNALA_BRANDT")  # fmt: skip
    return Calibration(path, *sides, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), model, tuple(D))


def read_kalibr(text: str, path: str) -> CameraReaders | None:
    """Read a camchain file of Kalibr, with the cameras cam0, cam1, ..."""
    data = _parse_mapping(text, path)
    if data is None:
        return None
    known = {str(name): entry for name, entry in data.items()
             if re.fullmatch(r"cam\d+", str(name)) and isinstance(entry, Mapping)}  # fmt: skip
    if not known or any(set(entry) & {"lens", "horizontal_fov"} for entry in known.values()):
        return None
    return {name: partial(_read_kalibr_camera, entry, f"{path}: {name}")
            for name, entry in known.items()}  # fmt: skip


def _read_kalibr_camera(entry: Mapping[str, Any], where: str) -> Calibration:
    projection = _read_entry(entry, "camera_model", where)
    if projection != "pinhole":
        raise CameraError(f"{where}: camera_model {format_value(projection)} is not supported: "
                          "calibrate with "
                          "pinhole-radtan or pinhole-equi")  # fmt: skip
    fx, fy, cx, cy = check_finite(
        _read_entry(entry, "intrinsics", where), f"{where}.intrinsics", (4,)
    )
    size = check_finite(_read_entry(entry, "resolution", where), f"{where}.resolution", (2,))
    width, height = (int(side) for side in size)
    if (width, height) != size:
        raise CameraError(
            f"{where}.resolution is {format_value(list(size))}, must be two whole numbers"
        )
    name = _read_entry(entry, "distortion_model", where)
    model = find_distortion_model(name, where)
    counts = (0,) if name == "none" else (4,)
    if name == "none" and not entry.get("distortion_coeffs"):
        D = ()
    else:
        D = check_finite(
            _read_entry(entry, "distortion_coeffs", where), f"{where}.distortion_coeffs", counts
        )
    return Calibration(where, width, height, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), model, D)


def read_visp(text: str, path: str) -> CameraReaders | None:
    """Read a file of ViSP's vpXmlParserCamera.

    If a camera has several models, the one with distortion is used. ViSP multiplies the image
    coordinates of the ideal pinhole by 1 + kud r^2, where r is their radius, so kud is Brown's
    coefficient k1. The file's second coefficient, kdu, belongs to an approximate inverse and is not
    used.
    """
    root = _parse_xml(text, path)
    if root.tag != "root" or root.find("camera") is None:
        return None
    known: CameraReaders = {}
    cameras = root.findall("camera")
    for camera in cameras:
        name = (camera.findtext("name") or NAME).strip()
        size = "x".join((camera.findtext(f"image_{s}") or "?").strip() for s in ("width", "height"))
        if sum((one.findtext("name") or NAME).strip() == name for one in cameras) > 1:
            name = f"{name}-{size}"
        models = {(one.findtext("type") or "").strip(): one for one in camera.findall("model")}
        if not models:
            raise CameraError(f"{path}: <model> of camera '{name}' is missing: calibrate it again")
        kind = VISP_DISTORTED if VISP_DISTORTED in models else next(iter(models))
        known[name] = partial(
            _read_visp_camera, camera, kind, models[kind], f"{path}: camera '{name}'"
        )
    return known


def _read_visp_camera(camera: Element, kind: str, model: Element, where: str) -> Calibration:
    def read_number(element: Element, tag: str) -> float:
        try:
            return safe_xml.parse_number(element.findtext(tag), f"{where}: <{tag}>")
        except DescriptionError as error:
            raise CameraError(f"{error}; correct <{tag}>") from None

    kinds = {VISP: (), VISP_DISTORTED: ("kud",), VISP_FISHEYE: ("k1", "k2", "k3", "k4")}
    if kind not in kinds:
        raise CameraError(f"{where}: <type> '{kind}' is not supported: {suggest(kind, kinds)}")
    sides = []
    for tag in ("image_width", "image_height"):
        side = None if camera.find(tag) is None else read_number(camera, tag)
        if side is not None and side != int(side):
            raise CameraError(f"{where}: <{tag}> is {side:g}, must be a whole number")
        sides.append(None if side is None else int(side))
    fx, fy, cx, cy = (read_number(model, tag) for tag in ("px", "py", "u0", "v0"))
    D = tuple(read_number(model, tag) for tag in kinds[kind])
    if kind == VISP_DISTORTED:
        kud, kdu = D[0], read_number(model, "kdu")
        if kud * kdu > 0.0:
            raise CameraError(f"{where}: <kud> {kud:g} and <kdu> {kdu:g} must have opposite "
                              "signs; calibrate the camera again")  # fmt: skip
        D = (kud, 0.0, 0.0, 0.0)
    elif kind == VISP_FISHEYE and model.find("k5") is not None and read_number(model, "k5"):
        raise CameraError(f"{where}: <k5> is {read_number(model, 'k5'):g}, but only four "
                          "coefficients are "
                          "supported: calibrate with k1 to k4")  # fmt: skip
    name = "equidistant" if kind == VISP_FISHEYE else "plumb_bob"
    return Calibration(where, *sides, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), name, D)


def refuse_xml(text: str, path: str) -> CameraReaders:
    """Raise CameraError for an XML file of an unknown format."""
    root = _parse_xml(text, path)
    raise CameraError(f"{path} is XML with the root <{root.tag}>, not a camera calibration of "
                      "OpenCV (<opencv_storage>) or ViSP (<root> with <camera>): give a "
                      "calibration file")


def _parse_xml(text: str, path: str) -> Element:
    try:
        return safe_xml.parse(text, path)
    except DescriptionError as error:
        raise CameraError(f"{error}: check that the file is complete") from None


def _parse_mapping(text: str, path: str) -> Mapping[str, Any] | None:
    # OpenCV's header is not valid YAML; programs without OpenCV's tags write it, too.
    found = parse_yaml(re.sub(r"\A%YAML\S*\s*(---)?", "", text), path, CameraError)
    return found if isinstance(found, Mapping) else None


def _read_entry(data: Mapping[str, Any], key: str, where: str) -> Any:
    if data.get(key) is None:
        near = find_nearest(key, map(str, data))
        remedy = f"correct the key '{near}'" if near else "add it"
        raise CameraError(f"{where}: {key} is missing; {remedy}")
    return data[key]


def _read_size(data: Mapping[str, Any], key: str, where: str) -> int:
    value = _read_entry(data, key, where)
    if not isinstance(value, int) or isinstance(value, bool):
        raise CameraError(f"{where}: {key} is {format_value(value)}, must be a whole number")
    return value


def find_readers(text: str) -> tuple[Reader, ...]:
    """Return the readers for the format of a text, in the order in which they are to be tried."""
    if text.lstrip().startswith("<"):
        return read_visp, read_opencv, refuse_xml
    if re.search("opencv-(nd-)?matrix", text):
        return (read_opencv,)
    if re.search(r"^\[image\]\s*$", text, re.MULTILINE):
        return (read_ros_ini,)
    others = (read_opencv,) if text.startswith("%YAML") else (read_ros,)
    return read_kalibr, read_camodocal, *others
