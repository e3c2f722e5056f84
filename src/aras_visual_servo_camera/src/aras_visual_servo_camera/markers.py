"""ArUco and AprilTag markers: which one is the target, and where it is in an image. By OpenCV.

A choice is written as

- `5`: number 5, of the first of SEARCHED that shows it;
- `DICT_5X5_100:5`, or `5X5_100:5`: of that dictionary;
- `DICT_5X5_100`: the largest of that dictionary;
- `{dictionary: DICT_5X5_100, size: 0.04, markers: {5: [0, 0], 7: [0.06, 0, 90]}}`: a flat board of
  markers with black squares of that size, m; of each marker the x and y of its middle on the board,
  m, y up, and its turn counter-clockwise, degrees.
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

# Cells across each dictionary's markers, the black rim with them.
DICTIONARIES = {
    **{f"DICT_{bits}X{bits}_{count}": bits + 2 for bits in (4, 5, 6, 7)
       for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 7, "DICT_ARUCO_MIP_36h12": 8, "DICT_APRILTAG_16h5": 6,
    "DICT_APRILTAG_25h9": 7, "DICT_APRILTAG_36h10": 8, "DICT_APRILTAG_36h11": 8,
}  # fmt: skip
# Those that are looked for, in this order, where none is chosen. One of a thousand holds the
# smaller ones of its kind, with the same numbers. Every 16th random square is one of 4X4_1000, so
# that is used by its name alone.
DEFAULT_DICTIONARY = "DICT_APRILTAG_36h11"
SEARCHED_DICTIONARIES = ("DICT_4X4_50", "DICT_APRILTAG_36h11", "DICT_5X5_1000", "DICT_6X6_1000",
            "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10",
            "DICT_ARUCO_MIP_36h12", "DICT_APRILTAG_16h5")  # fmt: skip


@dataclass(frozen=True, eq=False)
class DetectedMarker:
    """A marker in an image: its name `DICTIONARY:number`, corners (4, 2) px (column, row), from its
    own first one clockwise, to about half a pixel, and cells across."""

    name: str
    corners: np.ndarray
    cells: int


@dataclass(frozen=True)
class MarkerChoice:
    """Which marker, or which board of markers, is the target; see the module.

    dictionary: '' for any of SEARCHED. number: None for the largest in view. square: side of the
    markers of a board, m. board: middle x, y, m, and turn, rad, of each marker by number.
    """

    dictionary: str = ""
    number: int | None = None
    marker_size: float = 0.0
    board: Mapping[int, tuple[float, float, float]] | None = None

    @classmethod
    def read(cls, entry: str | int | Mapping[str, Any], where: str = "marker") -> MarkerChoice:
        """The choice that is written so; VisionError after `where` for what is none."""
        if isinstance(entry, str) and entry.lstrip().startswith("{"):  # as launch files have it
            entry = parse_yaml(entry, where, VisionError)
        if isinstance(entry, Mapping):
            return cls._read_board(entry, where)
        if not isinstance(entry, str | int) or isinstance(entry, bool):
            raise VisionError(f"{where} is {format_value(entry)}, must be a number, a text as "
                              "DICT_5X5_100:5, or a board")  # fmt: skip
        name, colon, number = str(entry).strip().rpartition(":")
        if not colon and number and not number.lstrip("-").isdigit():
            name, number = number, ""
        dictionary = _check_dictionary(name, where) if name else ""
        if not number:
            return cls(dictionary)
        if not number.isdigit():
            raise VisionError(f"{where} is {format_value(entry)}, must be a number from 0 on, as "
                              "5 or "
                              "DICT_5X5_100:5")  # fmt: skip
        return cls(dictionary, _check_number(int(number), dictionary, where))

    @classmethod
    def _read_board(cls, entry: Mapping[str, Any], where: str) -> MarkerChoice:
        keys = ("dictionary", "size", "markers")
        for key in entry:
            if key not in keys:
                raise VisionError(f"{where}: unknown key '{key}': {suggest(key, keys)}")
        for key in keys:
            if key not in entry:
                raise VisionError(f"{where}: key '{key}' of the board is missing")
        dictionary = _check_dictionary(str(entry["dictionary"]), where)
        square, markers = as_number(entry["size"]), entry["markers"]
        if square is None or square <= 0.0:
            raise VisionError(f"{where}.size is {format_value(entry['size'])}, must be the side "
                              "of a "
                              "marker's black square, above 0 m")  # fmt: skip
        if not isinstance(markers, Mapping) or not markers:
            raise VisionError(f"{where}.markers is {format_value(markers)}, must be places by "
                              "number, as "
                              "{5: [0, 0], 7: [0.06, 0]}")  # fmt: skip
        board = {}
        for number, place in markers.items():
            at = [as_number(v) for v in place] if isinstance(place, list | tuple) else []
            if len(at) not in (2, 3) or None in at or not str(number).isdigit():
                raise VisionError(f"{where}.markers.{number} is {format_value(place)}, must be x, "
                                  "y (m) "
                                  "and, where it is turned, degrees, of a number")  # fmt: skip
            known = _check_number(int(number), dictionary, where)
            board[known] = (at[0], at[1], math.radians(at[2] if len(at) == 3 else 0.0))
        return cls(dictionary, None, square, board)

    def __str__(self) -> str:
        if self.board is not None:
            numbers = ", ".join(map(str, self.board))
            return f"the board of markers {numbers} of {self.dictionary}"
        if self.number is not None:
            return f"marker {self.number}" + (f" of {self.dictionary}" if self.dictionary else "")
        return "the largest marker" + (f" of {self.dictionary}" if self.dictionary else "")

    @property
    def cells(self) -> int:
        """Across the marker that `draw_marker` draws, the black rim with them."""
        return DICTIONARIES[self.dictionary or DEFAULT_DICTIONARY]

    def draw_marker(self, side: int) -> np.ndarray:
        """The marker (side, side), px, without a white rim; what the choice leaves open is that of
        AprilTag 36h11, and number 0. VisionError for a number that it has not."""
        name = self.dictionary or DEFAULT_DICTIONARY
        number = _check_number(self.number or 0, name, "marker")
        return cv2.aruco.generateImageMarker(_load_dictionary(name), number, side)

    def detect(self, grey: NDArray[np.uint8]) -> list[DetectedMarker]:
        """The chosen marker, or those of the board that are in view, in an image (rows, columns).

        Raises:
            VisionError: it is not in view; the message names what was looked for, and what is.
        """
        other: list[str] = []
        for name in (self.dictionary,) if self.dictionary else SEARCHED_DICTIONARIES:
            found = _detect(name, np.ascontiguousarray(grey))
            chosen = [(number, one) for number, one in found if self._is_selected(number)]
            if chosen and self.board is None:
                chosen = [max(chosen, key=lambda item: cv2.contourArea(item[1].corners))]
            if chosen:
                return [one for _, one in chosen]
            other += [one.name for _, one in found]
        seen = f"; in view: {', '.join(sorted(set(other)))}" if other else ""
        searched = "" if self.dictionary else f" (of {', '.join(SEARCHED_DICTIONARIES)})"
        if self.number is None and self.board is None:
            dictionaries = self.dictionary or ", ".join(SEARCHED_DICTIONARIES)
            raise VisionError(f"no marker of {dictionaries} is in view")
        raise VisionError(f"{self} is not in view{searched}{seen}")

    def _is_selected(self, number: int) -> bool:
        if self.board is not None:
            return number in self.board
        return self.number is None or number == self.number

    def compute_marker_corners(self, name: str) -> np.ndarray:
        """(4, 2) m on the board, y up, of a found marker's corners."""
        x, y, turn = self.board[int(name.rpartition(":")[2])]
        half = 0.5 * self.marker_size
        square = np.array([(-half, half), (half, half), (half, -half), (-half, -half)])
        c, s = math.cos(turn), math.sin(turn)
        return square @ np.array([[c, s], [-s, c]]) + (x, y)

    def compute_board_corners(self) -> np.ndarray:
        """(4, 2) m: the rectangle about the board's markers, from upper left clockwise."""
        every = np.concatenate([self.compute_marker_corners(f":{number}") for number in self.board])
        (x, y), (X, Y) = every.min(axis=0), every.max(axis=0)
        return np.array([(x, Y), (X, Y), (X, y), (x, y)])

    def make_mask(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Mask (rows, columns), 255 within the marker or the markers; VisionError as `detect`."""
        mask = np.zeros(grey.shape, np.uint8)
        for one in self.detect(grey):
            cv2.fillConvexPoly(mask, np.rint(one.corners).astype(np.int32), 255)
        return mask


def _detect(name: str, grey: NDArray[np.uint8]) -> list[tuple[int, DetectedMarker]]:
    found, numbers, _ = _make_detector(name).detectMarkers(grey)
    return [
        (int(number), DetectedMarker(f"{name}:{int(number)}", corners.reshape(-1, 2),
                                  DICTIONARIES[name]))
        for number, corners in zip(np.ravel(numbers) if len(found) else (), found, strict=True)
    ]  # fmt: skip


def _check_dictionary(name: str, where: str) -> str:
    known = {one.lower(): one for one in DICTIONARIES}
    for spelling in (name.lower(), f"dict_{name.lower()}"):
        if spelling in known:
            return known[spelling]
    raise VisionError(f"{where}: dictionary {format_value(name)}: {suggest(name, DICTIONARIES)}")


def _check_number(number: int, dictionary: str, where: str) -> int:
    most = (
        max(
            _count_markers(name)
            for name in ((dictionary,) if dictionary else SEARCHED_DICTIONARIES)
        )
        - 1
    )
    if number > most:
        of = dictionary or "the largest dictionary"
        raise VisionError(f"{where}: number {number}, must be at most {most} in {of}")
    return number


def _load_dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


@functools.cache
def _count_markers(name: str) -> int:
    return len(_load_dictionary(name).bytesList)


@functools.cache
def _make_detector(name: str) -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(_load_dictionary(name))
