"""Meshes of the arm's links in their link frames, where z points down if all joints are at 0."""

from __future__ import annotations

import numpy as np
from mesh_primitives import (
    along_y,
    both_sides,
    box,
    capsule,
    circle,
    cylinder,
    extrude,
    loft,
    move,
    revolve,
    rounded_corners,
    rounded_rectangle,
)

ROUND = 24  # number of segments of the round outline of a joint
SMALL = 12  # number of segments of the round outline of a cover or a boss


def _across(outline_of_inset, inner: float, outer: float, bevel: float = 0.0) -> np.ndarray:
    """Build a plate normal to a joint axis (y) with a bevelled outer edge.

    outline_of_inset: function that returns the plate's outline (x, z), shrunk by an inset, m.
    inner, outer: positions of the plate's two faces along y, m.
    bevel: inset of the outline at the outer face, and length of the bevel along y, m.
    """
    sections = [(outline_of_inset(0.0), inner), (outline_of_inset(0.0), outer - bevel)]
    if bevel:
        sections.append((outline_of_inset(bevel), outer))
    # along_y needs the coordinates (z, x). Swapping them makes an outline clockwise, so the order
    # of its points is reversed, too.
    return along_y(loft([(outline[::-1, ::-1], y) for outline, y in sections]))


def link0() -> list[np.ndarray]:
    """Build the shoulder housing: a flange, the housing of the motor, and the seat of joint J1."""
    flange = extrude(rounded_rectangle(-0.169, 0.082, -0.093, 0.093, 0.012, 2), 0.0, 0.012)

    def belly(inset: float) -> np.ndarray:
        return rounded_corners(
            [
                (-0.157 + inset, 0.012),
                (0.0, 0.012),
                (0.0, 0.155 - inset),
                (-0.157 + inset, 0.155 - inset),
            ],
            [0, 0, 0, 0.075],
            7,
        )

    half = _across(belly, 0.0, 0.0785, 0.005)
    seat = revolve([(0.0785, 0.012), (0.0785, 0.147), (0.081, 0.147), (0.081, 0.168)], ROUND)
    cover = move(along_y(cylinder(0.046, 0.075, 0.082, SMALL + 4)), -0.083, 0, 0.08)
    return [flange, *both_sides(half, 1), seat, *both_sides(cover, 1)]


def link1() -> list[np.ndarray]:
    """Build the turntable below joint J1, the neck, and the barrel of joint J2."""
    table = revolve([(0.0775, 0.003), (0.0775, 0.034), (0.054, 0.064)], ROUND)
    seal = cylinder(0.072, 0.0, 0.003, ROUND)
    neck = extrude(rounded_rectangle(-0.052, 0.052, -0.0505, 0.0505, 0.02, 3), 0.05, 0.132)
    barrel = along_y(cylinder(0.0625, -0.053, 0.053, ROUND + 4))
    return [table, seal, neck, move(barrel, z=0.132)]


def link2() -> list[np.ndarray]:
    """Build the upper arm: two side plates with round ends, connected by a bridge."""
    cheek = _across(lambda i: capsule(0.0, 0.055 - i, 0.245, 0.053 - i, 20), 0.0555, 0.083, 0.005)
    hub = _across(lambda i: circle(0.062 - i, ROUND), 0.0555, 0.0865, 0.004)
    cap = cylinder(0.02, 0.08, 0.088, 12)
    elbow = cylinder(0.036, 0.08, 0.086, SMALL + 4)
    bridge = _across(
        lambda i: rounded_corners(
            [(-0.034, 0.085), (0.034, 0.085), (0.034, 0.165), (-0.034, 0.165)],
            [0.03, 0.03, 0.006, 0.006],
            4,
        ),
        -0.056,
        0.056,
    )
    out = [bridge]
    for part in (cheek, hub, along_y(cap), move(along_y(elbow), z=0.25)):
        out += both_sides(part, 1)
    return out


def link3() -> list[np.ndarray]:
    """Build the forearm: a tongue at joint J3 that widens to the fork of joint J5."""
    tongue = _across(lambda i: capsule(0.0, 0.0475, 0.085, 0.043, ROUND), -0.053, 0.053)
    body = extrude(rounded_rectangle(-0.041, 0.041, -0.0505, 0.0505, 0.010, 2), 0.05, 0.112)
    cheek = _across(lambda i: capsule(0.097, 0.0435 - i, 0.16, 0.041 - i, 20), 0.0245, 0.056, 0.004)
    cover = move(along_y(cylinder(0.028, 0.05, 0.058, SMALL + 4)), z=0.16)
    window = box(0.04, 0.0455, -0.016, 0.016, 0.068, 0.094)
    return [tongue, body, *both_sides(cheek, 1), *both_sides(cover, 1), *both_sides(window, 0)]


def link5() -> list[np.ndarray]:
    """Build the wrist: the disc of joint J5 inside the forearm's fork, and the stub at joint J6."""
    disc = _across(lambda i: capsule(-0.015, 0.042, 0.0, 0.042, ROUND), -0.022, 0.022)
    stub = cylinder(0.0215, 0.02, 0.046, SMALL + 4)
    return [disc, stub]


def link6() -> list[np.ndarray]:
    """Build the flange at joint J6 and the square housing of the camera."""
    flange = revolve(
        [(0.026, -0.026), (0.030, -0.022), (0.030, -0.006), (0.037, -0.006), (0.037, 0.006)],
        20,
    )
    housing = loft(
        [
            (rounded_rectangle(-s, s, -s, s, 0.006, 2), z)
            for s, z in ((0.041, 0.004), (0.045, 0.008), (0.045, 0.033))
        ]
    )
    return [flange, housing]
