"""A robot's description as far as kinematics goes: its joints, the way from link to link.

Read by hand and not by Pinocchio's own parser, so that a fault in the description is named in a
line, meshes need not be found, and what does not move the camera (grippers, wheels) is left out.
"""

import difflib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.poses import exponential, optical, transform

from ..errors import ConfigurationError

MOVING = ("revolute", "continuous", "prismatic")
OPTICAL, LINK = "_optical_frame", "_link"


@dataclass(frozen=True, eq=False)
class DescribedJoint:
    """One joint of a description.

    Attributes:
        name, kind: as the URDF has them; kind: revolute, continuous, prismatic, fixed, ...
        parent, child: links.
        origin: (4, 4) of the joint in its parent.
        axis: (3,) unit, in the joint's frame.
        lower, upper, velocity, effort: limits, infinite where there is none.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: np.ndarray
    axis: np.ndarray
    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf

    def at(self, position: float) -> np.ndarray:
        """`parent_T_child` (4, 4) with the joint at a position, rad or m."""
        moved = np.zeros(6)
        if self.kind == "prismatic":
            moved[:3] = position * self.axis
        elif self.kind in MOVING:
            moved[3:] = position * self.axis
        return self.origin @ exponential(moved)


class Description:
    """The joints of a URDF, by the link that hangs on them."""

    def __init__(self, urdf: str) -> None:
        """Read a description.

        Raises:
            ConfigurationError: no XML, no robot, or a joint without parent or child.
        """
        try:
            robot = ElementTree.fromstring(urdf)
        except ElementTree.ParseError as error:
            raise ConfigurationError(f"robot description is not XML: {error}") from error
        if robot.tag != "robot":
            raise ConfigurationError(f"robot description: <{robot.tag}> instead of <robot>")
        self._elements: dict[str, ElementTree.Element] = {}
        links = [link.get("name", "") for link in robot.findall("link")]
        for joint in robot.findall("joint"):
            parent, child = joint.find("parent"), joint.find("child")
            if parent is None or child is None:
                raise ConfigurationError(
                    f"robot description: joint {joint.get('name')} lacks its parent or child"
                )
            name = child.get("link", "")
            if name in self._elements:
                raise ConfigurationError(f"robot description: link {name} hangs on two joints")
            self._elements[name] = joint
            links += [name, parent.get("link", "")]
        self.links = tuple(dict.fromkeys(links))
        self.joints = tuple(joint.get("name", "") for joint in self._elements.values())

    def up(self, link: str) -> list[DescribedJoint]:
        """All joints from the root down to a link.

        Raises:
            ConfigurationError: a link that is not there (the nearest name is said), a loop, or a
                joint that cannot be used.
        """
        if link not in self.links:
            raise ConfigurationError(
                f"robot description has no link {link}{nearest(link, self.links)}"
            )
        joints: list[DescribedJoint] = []
        while link in self._elements:
            if len(joints) > len(self._elements):
                raise ConfigurationError(f"robot description: link {link} hangs on itself")
            joints.append(_read(self._elements[link]))
            link = joints[-1].parent
        return joints[::-1]

    def way(self, base: str, link: str) -> list[DescribedJoint]:
        """All joints from a base link down to a link; base '': from the root.

        An optical frame `x_optical_frame` that is not described hangs on its camera link `x_link`,
        which looks along its +x, z up, as Gazebo's cameras do.

        Raises:
            ConfigurationError: as `up`, or the link does not hang on the base.
        """
        camera = link.removesuffix(OPTICAL) + LINK
        if link not in self.links and link.endswith(OPTICAL) and camera in self.links:
            looking = DescribedJoint(
                f"{camera}_to_{link}", "fixed", camera, link, optical(np.eye(4)), np.eye(3)[0]
            )
            return [*self.way(base, camera), looking]
        joints = self.up(link)
        if not base or (joints and joints[0].parent == base) or base == link:
            return [] if base == link else joints
        below = [i for i, joint in enumerate(joints) if joint.child == base]
        if not below:
            known = [joint.parent for joint in joints]
            raise ConfigurationError(
                f"robot description: {link} does not hang on {base}{nearest(base, known)}"
            )
        return joints[below[0] + 1 :]


def nearest(name: str, known: Iterable[str]) -> str:
    """Words that help after 'there is no NAME': the nearest known name, or all where few."""
    known = [str(entry) for entry in known]
    close = difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]}?"
    return f"; there are {', '.join(known[:20])}" if known else ""


def _read(element: ElementTree.Element) -> DescribedJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    where = f"robot description: joint {name}"
    if kind not in (*MOVING, "fixed"):
        raise ConfigurationError(
            f"{where} on the way to the camera is '{kind}': {', '.join(MOVING)} and fixed are known"
        )
    place, axis = element.find("origin"), element.find("axis")
    place = {} if place is None else place.attrib
    origin = transform(
        _numbers(place, "xyz", "0 0 0", 3, where), _numbers(place, "rpy", "0 0 0", 3, where)
    )
    direction = np.array(_numbers({} if axis is None else axis.attrib, "xyz", "1 0 0", 3, where))
    length = float(np.linalg.norm(direction))
    limits: dict[str, float] = {}
    if kind != "fixed":
        if length < 1e-9:
            raise ConfigurationError(f"{where} has an axis of no length")
        if element.find("mimic") is not None:
            raise ConfigurationError(
                f"{where} mimics another and moves the camera: chains with such joints are not "
                "supported"
            )
        limits = _limits(element, kind, where)
    return DescribedJoint(
        name,
        kind,
        element.find("parent").get("link", ""),
        element.find("child").get("link", ""),
        origin,
        direction / max(length, 1e-9),
        **limits,
    )


def _limits(element: ElementTree.Element, kind: str, where: str) -> dict[str, float]:
    limit = element.find("limit")
    if limit is None:
        if kind == "continuous":
            return {}
        raise ConfigurationError(f"{where} has no <limit>: a {kind} joint needs one")
    values: dict[str, float] = {}
    for key in ("velocity", "effort"):
        if key in limit.attrib:
            values[key] = _numbers(limit.attrib, key, "", 1, where, finite=False)[0]
            if values[key] < 0.0:
                raise ConfigurationError(f"{where}: {key}='{limit.get(key)}' is negative")
    if kind == "continuous":
        return values
    for key in ("lower", "upper"):
        values[key] = _numbers(limit.attrib, key, "0", 1, where, finite=False)[0]
    if not values["lower"] < values["upper"]:
        raise ConfigurationError(
            f"{where}: lower limit {values['lower']:g} must be below the upper {values['upper']:g}"
        )
    return values


def _numbers(
    given: Mapping[str, str], key: str, default: str, count: int, where: str, finite: bool = True
) -> list[float]:
    text = given.get(key, default)
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or np.isnan(numbers).any() or finite and np.isinf(numbers).any():
        words = "a number" if count == 1 else f"{count} finite numbers"
        raise ConfigurationError(f"{where}: {key}='{text}' must be {words}")
    return numbers
