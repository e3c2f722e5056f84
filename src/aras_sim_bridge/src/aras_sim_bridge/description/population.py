"""Expansion of SDF's `<population>`: many copies of one model in a region of a world."""

from __future__ import annotations

import copy
import math
import zlib
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.safe_xml import ElementReader, find_text, shorten
from aras_visual_servo_base.urdf import ZERO

# largest number of copies of one <population>; each is simulated separately
LARGEST_POPULATION = 1000
_LINES = ("linear-x", "linear-y", "linear-z")


def place_copies(population: Element, warnings: list[str]) -> list[Element]:
    """Return the copies of the model of a population, named <model>_clone_0, <model>_clone_1, ….

    The copies are upright and arranged as in Gazebo. Random positions depend only on the
    population's name and differ from Gazebo's.

    Returns:
        The copies. If the population is not supported, an empty list; `warnings` then gets a
        sentence.
    """
    where = f"<population> '{shorten(population.get('name') or '')}'"
    try:
        model = population.find("model")
        if model is None:
            raise DescriptionError(f"{where}: <model> is missing; add it")
        places = _compute_positions(population, where)
    except DescriptionError as error:
        warnings.append(f"{error}; this <population> is ignored")
        return []
    found = []
    for i, place in enumerate(places):
        clone = copy.deepcopy(model)
        for old in clone.findall("pose"):
            clone.remove(old)
        clone.set("name", f"{model.get('name')}_clone_{i}")
        ElementTree.SubElement(clone, "pose").text = " ".join(map(repr, (*place, 0.0, 0.0, 0.0)))
        found.append(clone)
    return found


def _compute_positions(population: Element, where: str) -> list[Vector3]:
    """Return the positions of the copies in the world, m."""
    pose = safe_xml.parse_pose(find_text(population, "pose"), f"{where}: pose")
    settings = ElementReader(population, f"{where}: ")
    distribution = ElementReader(population.find("distribution"), f"{where}: ")
    kind = distribution.read_text("type") or "random"
    if kind == "grid":
        rows = _read_count(distribution, "rows")
        columns = _read_count(distribution, "cols", LARGEST_POPULATION // rows)
        step = distribution.read_numbers("step", 3, (0.5, 0.5, 0.0))
        inside = [(j * step[0], i * step[1], 0.0) for i in range(rows) for j in range(columns)]
        corner = ((columns - 1) * step[0] / 2, (rows - 1) * step[1] / 2, 0.0)
    else:
        count = _read_count(settings, "model_count")
        random = np.random.default_rng(zlib.crc32((population.get("name") or "").encode()))
        box, cylinder = population.find("box"), population.find("cylinder")
        if box is not None and kind in ("random", *_LINES):
            size = ElementReader(box, f"{where}: ").read_numbers("size", 3)
            if min(size) <= 0.0:
                raise DescriptionError(f"{where}: size {size} must be positive")
            corner = tuple(side / 2 for side in size)
            if kind == "random":
                inside = (random.random((count, 3)) * size).tolist()
            else:
                axis = _LINES.index(kind)
                inside = [tuple(size[axis] * i / count if k == axis else corner[k]
                                for k in range(3)) for i in range(count)]
        elif cylinder is not None and kind == "random":
            reader = ElementReader(cylinder, f"{where}: ")
            radius, length = reader.read_number("radius"), reader.read_number("length")
            if radius <= 0.0 or length <= 0.0:
                raise DescriptionError(f"{where}: radius and length must be positive")
            angle, share, height = random.random((3, count))
            # As in Gazebo, the distance from the axis is uniformly distributed, so the positions
            # are denser near the axis.
            out = radius * share
            inside = np.transpose([out * np.cos(2 * math.pi * angle),
                                   out * np.sin(2 * math.pi * angle), length * height]).tolist()
            corner = ZERO  # as in Gazebo, the pose of the region is that of the cylinder's base
        else:
            raise DescriptionError(f"{where}: distribution '{shorten(kind)}' is not supported in "
                                   "this region; use a <box> with random, linear-x, linear-y or "
                                   "linear-z, a <cylinder> with random, or grid")
    # Subtract `corner`, the offset from the region's corner to its centre. As in Gazebo, it is in
    # the world's axes even if the region is rotated.
    moved = Pose(tuple(a - b for a, b in zip(pose.xyz, corner, strict=True)), pose.quat)
    return [moved.apply(tuple(one)) for one in inside]


def _read_count(reader: ElementReader, tag: str, most: int = LARGEST_POPULATION) -> int:
    value = reader.read_integer(tag, 1)
    if not 1 <= value <= most:
        raise DescriptionError(f"{reader.prefix}{tag} is {value}, must be 1 to {most}")
    return value
