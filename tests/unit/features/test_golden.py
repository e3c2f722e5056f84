"""Reference values from another library and from 50-digit arithmetic.

golden.json holds five cases.
"""

from __future__ import annotations

import hashlib
import json
import re
from math import pi
from pathlib import Path

import numpy as np
import pytest
from feature_cases import pixels_inside

from aras_visual_servo_camera.features import Reference
from aras_visual_servo_camera.features import compute_moment_features as compute
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments, Pinhole

GOLDEN = Path(__file__).parent / "golden.json"


CASES = [
    pytest.param(case, kind, id=f"{case['name']}-{kind}")
    for case in json.loads(GOLDEN.read_text())["cases"]
    for kind in case["variants"]
]


def _moments(case: dict, kind: str) -> tuple[Moments, Moments]:
    """Current and desired moments."""
    if kind == "discrete":
        return (
            Moments.from_points(case["vertices"]),
            Moments.from_points(case["desired_vertices"]),
        )
    desired = Moments.from_polygon(case["desired_vertices"])
    if kind == "polygon":
        return Moments.from_polygon(case["vertices"]), desired
    camera = case["camera"]
    pinhole = Pinhole(camera["px"], camera["py"], camera["u0"], camera["v0"])
    mask = pixels_inside(np.array(case["vertices"]), pinhole, (camera["height"], camera["width"]))
    spec = case["image_spec"]
    assert int(mask.sum()) == spec["pixels_on"]
    assert hashlib.sha256(mask * np.uint8(255)).hexdigest() == spec["sha256_of_raw_bytes"]
    return Moments.from_image(mask, pinhole), desired


@pytest.mark.parametrize(("case", "kind"), CASES)
def test_values_and_rows_are_those_of_another_library(case: dict, kind: str) -> None:
    variant = case["variants"][kind]
    moments, desired = _moments(case, kind)
    reference = Reference.from_moments(desired, variant["desired"]["Zstar"])
    names = tuple(variant["L"])
    result = compute(moments, names, Plane(*case["plane_ABC"]), reference)
    rg2 = (variant["mu"]["mu20"] + variant["mu"]["mu02"]) / variant["m"]["m00"]
    R = (rg2 + variant["xg"] ** 2 + variant["yg"] ** 2) ** 0.5

    def scale(name: str) -> float:
        if match := re.match(r"(m|mu)(\d)(\d)$", name):
            radius = R if match[1] == "m" else rg2**0.5
            return variant["m"]["m00"] * radius ** (int(match[2]) + int(match[3]))
        return {"xg": R, "yg": R}.get(name, variant["an"] if name in ("an", "xn", "yn") else 1.0)

    def agrees(key: str, ours, expected, size: float) -> None:
        flag = variant["flags"].get(key)
        expected = expected if flag is None else flag["independent"]
        if expected is None:
            return
        error = np.abs(np.subtract(ours(), expected)).max()
        assert error <= 1e-7 * max(np.abs(expected).max(), size), (key, ours(), expected)

    for name in names:
        key = "alpha_sym" if name == "alpha" else name
        value = {**variant["m"], **variant["mu"]}.get(key, variant.get(key))
        agrees(key, lambda n=name: result[n], value, scale(name))
        agrees("L." + name, lambda n=name: result.get_interaction_row(n), variant["L"][name], 1e-3)
    for table, read in (("m", moments.m), ("mu", moments.mu)):
        for name, value in variant[table].items():
            agrees(name, lambda n=name, r=read: r(int(n[-2]), int(n[-1])), value, scale(name))

    truth = variant["alpha_full_independent"]
    if truth is None or reference.orientation is None:
        return
    full = compute(moments, ("alpha_full",), Plane(*case["plane_ABC"]), reference)["alpha_full"]
    turns = 1.0 if reference.orientation.is_symmetric else 2.0  # half turns show no difference
    assert abs((full - truth + turns * pi / 2) % (turns * pi) - turns * pi / 2) < 1e-7
