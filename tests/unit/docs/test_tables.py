"""Numbers in tables of the documentation, and defaults in help texts, agree with the code."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from blocks import PAGES, ROOT

from aras_sim_bridge.camera.config import CameraConfig
from aras_sim_bridge.camera.lens import COEFFICIENTS, LARGEST_ANGLE, RADIUS_FUNCTION
from aras_sim_bridge.ros.runtime.node_parameters import NodeParameters
from aras_visual_servo_base.settings import list_defaults
from aras_visual_servo_camera.feature_plan import compute_required_order
from aras_visual_servo_camera.moments import POINTS
from aras_visual_servo_camera.parameters import VisionParameters
from aras_visual_servo_controller.settings import ControllerSettings

BRIDGE, CAMERA_KEYS = "src/aras_sim_bridge/README.md", "src/aras_sim_bridge/docs/camera.md"
CAMERA, WORLD = "src/aras_visual_servo_camera/README.md", "src/aras_visual_servo_gazebo/README.md"
CONTROLLER = "src/aras_visual_servo_controller/README.md"
# Tables with numbers, by page and first words of their heading: recomputed here ...
CHECKED = {
    (BRIDGE, "parameter"), (CAMERA, "parameter"), (WORLD, "argument"), (CAMERA_KEYS, "key"),
    ("docs/theory.md", "λ, 1/s"), ("docs/studies.md", "name"), ("docs/moments.md", "name"),
    (CONTROLLER, "name"), ("docs/camera.md", "lens"),
}  # fmt: skip
# ... or measured, and written by which program, which takes too long for a test.
STEPS = "tests/unit/world/test_step_response.py"
MEASURED = {
    ("docs/schemes.md", "scheme"): "docs/schemes_page.py",
    ("docs/schemes.md", "feature"): "tests/benchmarks/features.py",
    ("docs/truth.md", "check"): "tests/truth",
    ("docs/truth.md", "outcome"): "tests/outcomes",
    ("docs/step_response.md", "joint"): STEPS,
    ("docs/step_response.md", "step, all joints at once"): STEPS,
    ("docs/step_response.md", "one joint alone, 0 → 0.1"): STEPS,
    ("docs/porting.md", "suite"): "tests/peers",
    ("docs/solid_targets.md", "solid, seeds"): "tests/benchmarks/model_tracking.py",
    ("docs/differences.md", "run"): "tests/benchmarks/original_controllers.py",
    (CAMERA_KEYS, "preset"): "tests/benchmarks/calibrate_live.py",
    ("tests/README.md", "faults"): "tests/faults",
    ("tests/README.md", "ms per image, 2026-12-01, a shared machine with two cores"):
        "tests/benchmarks/peers.py",
}
NUMBER = re.compile(r"[-+−]?\d[\d .,e\[\]%()/+−-]*(?: ?(?:s|ms|mm|m|rad|°|Hz|%|MB|min|h))?$")


def tables(page: Path) -> Iterator[list[list[str]]]:
    """Rows of cells of each table, the heading first."""
    rows: list[list[str]] = []
    for line in [*page.read_text(encoding="utf-8").splitlines(), ""]:
        if line.startswith("|"):
            rows.append([c.strip() for c in re.split(r"(?<!\\)\|", line.strip()[1:-1])])
        elif rows:
            yield [rows[0], *rows[2:]]
            rows = []


def table(page: str, first: str) -> list[list[str]]:
    """Return the rows of all tables of a page whose heading starts with `first`, without headings.
    """
    found = [rows for rows in tables(ROOT / page) if rows[0][0] == first]
    assert found, (page, first)
    return [row for rows in found for row in rows[1:]]


def names_of(cell: str) -> list[str]:
    return [name.lstrip("~") for name in re.findall(r"`([^`]+)`", cell)]


def listed(cell: str, count: int) -> list[str]:
    """Return the words of a cell for `count` names; one word counts for all."""
    plain = cell.replace("`", "")
    parts = plain.split(", ") if count > 1 else [plain]
    return parts * count if len(parts) == 1 else parts


def test_every_table_of_numbers_is_recomputed_or_says_who_measures_it():
    found = set()
    for page in PAGES:
        for heading, *rows in tables(page):
            if any(NUMBER.match(cell.strip("`*")) for row in rows for cell in row[1:]):
                found.add((str(page.relative_to(ROOT)), heading[0]))
    told = CHECKED | set(MEASURED)
    assert found == told, f"name in CHECKED or MEASURED, or take out: {sorted(found ^ told)}"
    for who in MEASURED.values():
        assert (ROOT / who).exists(), who


def test_rates_of_decay_are_those_of_the_loop_that_the_page_describes():
    """Stepped image by image, not by the polynomial's roots; and lenses reach as far as they draw.
    """
    heading, *rows = next(t for t in tables(ROOT / "docs/theory.md") if t[0][0] == "λ, 1/s")
    lateness = [float(re.search(r"τ = (\d+)", cell)[1]) / 1e3 for cell in heading[1:]]
    period = 1.0 / 30.0
    for gain, *cells in rows:
        for tau, cell in zip(lateness, cells, strict=True):
            n, rest = int(tau // period), tau % period
            s = [1.0] * (n + 2)
            for _ in range(400):
                s.append(s[-1] - float(gain) * ((period - rest) * s[-1 - n] + rest * s[-2 - n]))
            assert cell == f"{-math.log(s[-1] / s[-31]):.2f}", (gain, tau)
    lenses = table("docs/camera.md", "lens")
    assert {row[0] for row in lenses} == set(RADIUS_FUNCTION)
    for name, _, reach, models in lenses:
        degrees = math.degrees(2 * LARGEST_ANGLE[name])
        assert degrees == pytest.approx(float(re.search(r"\d+", reach)[0]))
        assert set(names_of(models)) <= set(COEFFICIENTS)


def test_moments_that_a_feature_needs_are_those_of_its_formula():
    names = [name for row in table("docs/moments.md", "name") for name in names_of(row[0])]
    told: dict[str, str] = {}
    for cell, _, order in table("docs/moments.md", "name"):
        parts = cell.split("; ")
        orders = order.split("; ") if ";" in order else [order] * len(parts)
        for part, one in zip(parts, orders, strict=True):
            found = names_of(part)
            if "…" in part and found[0][0] == found[1][0] == "C":  # from, to
                low, high = (int(name[1:]) for name in found[:2])
                found = [f"C{k}" for k in range(low, high + 1)]
            told |= dict.fromkeys(found, one)
    numbers = {name: one for name, one in told.items() if one[0].isdigit()}
    assert set(numbers) >= {"C1", "C5", "C10", "alpha", "alpha_full", "Pyn", "area"} <= {*names,
                                                                                       "C5", "C10"}
    for name, one in numbers.items():
        assert compute_required_order([name]) == int(one[0]), name
    assert told["area"] == f"2 (points: {compute_required_order(['area'], POINTS)})"
    assert [compute_required_order([name]) for name in ("m20", "mu21")] == [3, 4]  # i + j + 1


# -- defaults in tables --------------------------------------------------------------------------


def same(told: str, value: object) -> bool:
    """Return whether a cell states this default."""
    if told == str(value):
        return True
    words = {"empty": ("", (), []), "none": (None, -1.0, "", ()), "''": ("",), "": ("",)}
    if told in words:
        return value in words[told]
    if isinstance(value, bool):
        return told == str(value).lower()
    if isinstance(value, list | tuple | np.ndarray) and not told.startswith("["):
        return all(same(told, one) for one in value)
    if isinstance(value, int | float):
        return NUMBER.match(told) is not None and float(told) == value
    return isinstance(value, tuple) and json.loads(told) == list(value)


@pytest.mark.parametrize(("page", "heading", "kind", "column"), [
    (BRIDGE, "parameter", NodeParameters, 2), (CAMERA, "parameter", VisionParameters, 1),
    (CONTROLLER, "name", ControllerSettings, 1)])  # fmt: skip
def test_parameters_are_listed_with_their_defaults(page, heading, kind, column):
    known = list_defaults(kind)
    for row in table(page, heading):
        for name in names_of(row[0]):
            if name in known:
                told = row[column].strip("`")
                assert same(told, known.pop(name)), (name, told)
    assert not known


# In place of a default: what it follows from.
FOLLOWS = ("the plugin's", "the node's", "largest angle", "from the node's", "the multicamera's",
           "the plugin's, none")  # fmt: skip


def test_keys_of_a_camera_are_listed_with_their_defaults_and_units():
    plain = CameraConfig()
    seen = set()
    for cell, unit, default, _ in table(CAMERA_KEYS, "key"):
        names = names_of(cell)
        seen |= {name.partition("/")[0] for name in names}
        if default.startswith(FOLLOWS) or not default:
            continue
        values = listed(default, len(names))
        for name, told in zip(names, values, strict=True):
            value = plain
            for part in name.split("/"):
                field = next(f for f in dataclasses.fields(value) if f.name == part)
                value = getattr(value, part)
            assert same(told, value), (name, told, value)
            said = field.metadata.get("unit", "").partition("(")[0]
            units = [unit, *(word.strip() for word in unit.split(","))]
            assert not said or said in units, (name, unit, said)
    assert seen == {f.name for f in dataclasses.fields(CameraConfig)} - {"name", "link"}


def test_arguments_of_launch_files_are_listed_with_their_defaults():
    known: dict[str, set[str]] = {}
    for file in (ROOT / "src/aras_visual_servo_gazebo/launch").glob("*.launch"):
        for arg in ElementTree.parse(file).getroot().iter("arg"):
            if arg.get("default") is not None and arg.get("value") is None:
                known.setdefault(arg.get("name"), set()).add(arg.get("default"))
    compared = 0
    for cell, default, _ in table(WORLD, "argument"):
        names = names_of(cell)
        told = names_of(default)
        if len(told) != len(names) or " " in default.replace("`, `", ""):
            continue  # in words
        for name, value in zip(names, told, strict=True):
            assert name in known, name
            own = str(getattr(ControllerSettings(), name, None)) if "" in known[name] else None
            assert value == own or any(f"/{d}".endswith(f"/{value}") for d in known[name]), name
            compared += 1
    assert compared >= 30
