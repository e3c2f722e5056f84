"""Choice and detection of ArUco and AprilTag markers with OpenCV.

The setting that chooses the target's marker or board has one of these forms:

- `5`: marker number 5; the dictionaries in SEARCHED_DICTIONARIES are tried until it is found;
- `DICT_5X5_100:5`, or `5X5_100:5`: marker number 5 of this dictionary;
- `DICT_5X5_100`: the largest visible marker of this dictionary;
- `{dictionary: DICT_5X5_100, size: 0.04, markers: {5: [0, 0], 7: [0.06, 0, 90]}}`: a flat board of
  markers. `size` is the side of each marker's black square in m. `markers` contains, for each
  number, x and y of the marker's middle on the board in m (y is up), and optionally its
  counter-clockwise rotation in degrees.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import as_number, format_value
from aras_visual_servo_base.yaml_files import parse_yaml

from .errors import VisionError

# For each marker dictionary, the number of cells across a marker, including the black rim.
DICTIONARIES = {
    **{f"DICT_{bits}X{bits}_{count}": bits + 2 for bits in (4, 5, 6, 7)
       for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 7, "DICT_ARUCO_MIP_36h12": 8, "DICT_APRILTAG_16h5": 6,
    "DICT_APRILTAG_25h9": 7, "DICT_APRILTAG_36h10": 8, "DICT_APRILTAG_36h11": 8,
}  # fmt: skip
DEFAULT_DICTIONARY = "DICT_APRILTAG_36h11"
# Dictionaries that are searched in this order if the setting names no dictionary. A dictionary of
# 1000 markers contains the markers of the smaller dictionaries with the same number of bits.
# DICT_4X4_1000 is not searched, because one in 16 random squares would be detected as one of its
# markers.
SEARCHED_DICTIONARIES = ("DICT_4X4_50", "DICT_APRILTAG_36h11", "DICT_5X5_1000", "DICT_6X6_1000",
            "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10",
            "DICT_ARUCO_MIP_36h12", "DICT_APRILTAG_16h5")  # fmt: skip


@dataclass(frozen=True, eq=False)
class DetectedMarker:
    """A marker found in an image.

    Attributes:
        name: `DICTIONARY:number`.
        corners: (4, 2) px (column, row), clockwise from the marker's first corner, with an error of
            about half a pixel.
        cells: number of cells across the marker, including the black rim.
    """

    name: str
    corners: np.ndarray
    cells: int


@dataclass(frozen=True)
class MarkerChoice:
    """The marker, or the board of markers, that is the target.

    This module's docstring explains how users choose a marker or a board.

    Attributes:
        dictionary: name of the dictionary; '' for any dictionary in SEARCHED_DICTIONARIES.
        number: number of the marker; None for the largest visible marker.
        marker_size: side of the black square of a board's markers, m.
        board: for each number, x and y of the marker's middle on the board, m, and its rotation,
            rad; None if the target is a single marker.
    """

    dictionary: str = ""
    number: int | None = None
    marker_size: float = 0.0
    board: Mapping[int, tuple[float, float, float]] | None = None

    @classmethod
    def read(cls, entry: str | int | Mapping[str, Any], where: str = "marker") -> MarkerChoice:
        """Parse the setting that chooses a marker or a board.

        Args:
            entry: choice in one of the forms of this module's docstring.
            where: name of the setting, for messages.

        Raises:
            VisionError: the choice is invalid.
        """
        # In a launch file, a board is given as YAML text.
        if isinstance(entry, str) and entry.lstrip().startswith("{"):
            entry = parse_yaml(entry, where, VisionError)
        if isinstance(entry, Mapping):
            return cls._read_board(entry, where)
        if not isinstance(entry, str | int) or isinstance(entry, bool):
            raise VisionError(f"{where} is {format_value(entry)}, must be a number, a text "
                              "such as DICT_5X5_100:5, or a mapping with the keys dictionary, size "
                              "and markers")  # fmt: skip
        name, colon, number = str(entry).strip().rpartition(":")
        if not colon and number and not number.lstrip("-").isdigit():
            name, number = number, ""
        dictionary = _check_dictionary(name, where) if name else ""
        if not number:
            return cls(dictionary)
        if not number.isdigit():
            raise VisionError(f"{where} is {format_value(entry)}, must be a number of at least "
                              "0, such as 5 or DICT_5X5_100:5")  # fmt: skip
        return cls(dictionary, _check_number(int(number), dictionary, where))

    @classmethod
    def _read_board(cls, entry: Mapping[str, Any], where: str) -> MarkerChoice:
        keys = ("dictionary", "size", "markers")
        for key in entry:
            if key not in keys:
                raise VisionError(f"{where}: unknown key '{key}': {suggest(key, keys)}")
        for key in keys:
            if key not in entry:
                raise VisionError(
                    f"{where}: key '{key}' of the board is missing; a board needs "
                    f"{', '.join(keys)}"
                )
        dictionary = _check_dictionary(str(entry["dictionary"]), where)
        marker_size, markers = as_number(entry["size"]), entry["markers"]
        if marker_size is None or marker_size <= 0.0:
            raise VisionError(f"{where}.size is {format_value(entry['size'])}, must be above 0: "
                              "the side of a marker's black square in m")  # fmt: skip
        if not isinstance(markers, Mapping) or not markers:
            raise VisionError(f"{where}.markers is {format_value(markers)}, must be a position "
                              "in m for each marker's number, such as "
                              "{5: [0, 0], 7: [0.06, 0]}")  # fmt: skip
        board = {}
        for number, place in markers.items():
            values = [as_number(v) for v in place] if isinstance(place, list | tuple) else []
            if len(values) not in (2, 3) or None in values or not str(number).isdigit():
                raise VisionError(f"{where}.markers.{number} is {format_value(place)}, must be "
                                  "[x, y] in m or [x, y, degrees], and the key must be the number "
                                  "of a marker")  # fmt: skip
            checked_number = _check_number(int(number), dictionary, where)
            x, y, degrees = (*values, 0.0)[:3]
            board[checked_number] = x, y, math.radians(degrees)
        return cls(dictionary, None, marker_size, board)

    def __str__(self) -> str:
        if self.board is not None:
            numbers = ", ".join(map(str, self.board))
            return f"the board of markers {numbers} of {self.dictionary}"
        if self.number is not None:
            return f"marker {self.number}" + (f" of {self.dictionary}" if self.dictionary else "")
        return "the largest marker" + (f" of {self.dictionary}" if self.dictionary else "")

    @property
    def cells(self) -> int:
        """Number of cells across the marker that `draw_marker` draws, including the black rim."""
        return DICTIONARIES[self.dictionary or DEFAULT_DICTIONARY]

    def draw_marker(self, side: int) -> np.ndarray:
        """Draw the marker as an image of side x side pixels without a white rim.

        If the user chose no dictionary, the marker is from AprilTag 36h11. If the user chose no
        number, it is marker 0.

        Raises:
            VisionError: the dictionary has no marker with this number.
        """
        name = self.dictionary or DEFAULT_DICTIONARY
        number = _check_number(self.number or 0, name, "marker")
        return cv2.aruco.generateImageMarker(_load_dictionary(name), number, side)

    def detect(self, grey: NDArray[np.uint8]) -> list[DetectedMarker]:
        """Find the chosen marker, or the visible markers of the board, in an image (rows, columns).

        Raises:
            VisionError: neither the chosen marker nor a marker of the board is visible; the message
                lists the markers that are visible.
        """
        other_names: list[str] = []
        for name in (self.dictionary,) if self.dictionary else SEARCHED_DICTIONARIES:
            found = _detect(name, np.ascontiguousarray(grey))
            if self.board is not None:
                chosen = [marker for number, marker in found if number in self.board]
            else:
                chosen = [m for number, m in found if self.number in (None, number)]
                chosen = sorted(chosen, key=lambda m: -cv2.contourArea(m.corners))[:1]
            if chosen:
                return chosen
            other_names += [marker.name for _, marker in found]
        in_view = f"; in view: {', '.join(sorted(set(other_names)))}" if other_names else ""
        searched = "" if self.dictionary else f" (of {', '.join(SEARCHED_DICTIONARIES)})"
        if self.number is None and self.board is None:
            dictionaries = self.dictionary or ", ".join(SEARCHED_DICTIONARIES)
            raise VisionError(
                f"no marker of {dictionaries} is in view; move the camera, or set the marker's "
                "dictionary"
            )
        raise VisionError(f"{self} is not in view{searched}{in_view}")

    def compute_marker_corners(self, name: str) -> np.ndarray:
        """Return the corners (4, 2), m, of one of the board's markers, in the axes of the board.

        name: `DICTIONARY:number` of the marker. The y axis of the board is up.
        """
        x, y, turn = self.board[int(name.rpartition(":")[2])]
        c, s = math.cos(turn), math.sin(turn)
        return make_square(self.marker_size) @ np.array([[c, s], [-s, c]]) + (x, y)

    def compute_board_corners(self) -> np.ndarray:
        """Compute the corners (4, 2), m, of the rectangle around all markers of the board.

        The order is clockwise from the upper left corner.
        """
        corners = np.concatenate(
            [self.compute_marker_corners(f":{number}") for number in self.board]
        )
        (x, y), (X, Y) = corners.min(axis=0), corners.max(axis=0)
        return np.array([(x, Y), (X, Y), (X, y), (x, y)])

    def make_mask(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a mask (rows, columns), 255 inside the chosen markers, 0 elsewhere.

        Raises:
            VisionError: none of the chosen markers is visible.
        """
        mask = np.zeros(grey.shape, np.uint8)
        for marker in self.detect(grey):
            cv2.fillConvexPoly(mask, np.rint(marker.corners).astype(np.int32), 255)
        return mask


def make_square(side: float) -> np.ndarray:
    """Return the corners (4, 2) of a square about (0, 0), clockwise from the upper left (y is up).
    """
    half = 0.5 * side
    return np.array([(-half, half), (half, half), (half, -half), (-half, -half)])


def _detect(name: str, grey: NDArray[np.uint8]) -> list[tuple[int, DetectedMarker]]:
    found, numbers, _ = _make_detector(name).detectMarkers(grey)
    numbers = np.ravel(numbers).tolist() if len(found) else []
    markers = []
    for number, corners in zip(numbers, found, strict=True):
        marker = DetectedMarker(f"{name}:{number}", corners.reshape(-1, 2), DICTIONARIES[name])
        markers.append((number, marker))
    return markers


def _check_dictionary(name: str, where: str) -> str:
    known = {one.lower(): one for one in DICTIONARIES}
    for spelling in (name.lower(), f"dict_{name.lower()}"):
        if spelling in known:
            return known[spelling]
    raise VisionError(
        f"{where}: there is no dictionary {format_value(name)}: {suggest(name, DICTIONARIES)}"
    )


def _check_number(number: int, dictionary: str, where: str) -> int:
    names = (dictionary,) if dictionary else SEARCHED_DICTIONARIES
    highest = max(map(_count_markers, names)) - 1
    if number > highest:
        owner = dictionary or "the largest dictionary"
        raise VisionError(
            f"{where}: the marker's number is {number}, must be at most {highest} in {owner}"
        )
    return number


def _load_dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@functools.cache
def _count_markers(name: str) -> int:
    return len(_load_dictionary(name).bytesList)


@functools.cache
def _make_detector(name: str) -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(_load_dictionary(name))
