"""Meshes of the gantry: frame, table, rail and belt drive (base_link), and carriage (slider)."""

from __future__ import annotations

import numpy as np
from mesh_primitives import (
    along_x,
    along_y,
    both_sides,
    box,
    cylinder,
    extrude,
    grooved_square,
    loft,
    mirror,
    move,
    rectangle,
    revolve,
    rounded_corners,
    rounded_rectangle,
    slotted_square,
)

PROFILE = 0.09  # edge length of the section of the frame's aluminium profile, m
FRAME_X = 1.2  # half length of the frame along x, m; only the belt drive extends beyond the frame
FRAME_Y = 0.68  # half width of the frame along y, m
FRAME_Z = 1.75  # m, height
TABLE_TOP = 0.59  # height of the table's surface, on which the target lies, m
# position (y, z) and radius of the two guide rods of the carriage, m
ROD_Y, ROD_Z, ROD_RADIUS = 0.05, 1.634, 0.011
MOTOR_X, MOTOR_Z = 1.3855, 1.626  # position (x, z) of the axis of the belt motor, m


def base_link() -> list[np.ndarray]:
    """Build the parts of base_link, in a frame with z up and the floor at z = 0."""
    table = box(-1.09, 1.09, -0.57, 0.57, 0.06, TABLE_TOP)
    return [table, *_frame(), *_brackets(), *_rail(), *_drive()]


def _profile(length_from: float, length_to: float, open_end: bool = False) -> np.ndarray:
    """Build an aluminium profile along z.

    If `open_end`, the end is visible, so the profile has T-slots. Otherwise, it has simple grooves.
    """
    if open_end:
        outline = slotted_square(PROFILE, opening=0.012, lip=0.006, cavity=0.024, depth=0.018)
    else:
        outline = grooved_square(PROFILE, opening=0.012, depth=0.014)
    return extrude(outline, length_from, length_to)


def _frame() -> list[np.ndarray]:
    x, y, half = FRAME_X - PROFILE / 2, FRAME_Y - PROFILE / 2, PROFILE / 2
    post = _profile(PROFILE, FRAME_Z, open_end=True)
    posts = [move(post, sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)]
    sill = along_x(_profile(-FRAME_X, FRAME_X))
    sills = [move(sill, y=sy * y, z=half) for sy in (-1, 1)]
    cross = along_y(_profile(-FRAME_Y + PROFILE, FRAME_Y - PROFILE))
    crosses = [move(cross, sx * x, z=z) for sx in (-1, 1) for z in (half, FRAME_Z - half)]
    spine = move(along_x(_profile(-FRAME_X + PROFILE, FRAME_X - PROFILE)), z=FRAME_Z - half)
    return [*posts, *sills, *crosses, spine]


def _brackets() -> list[np.ndarray]:
    """Build the triangular corner brackets between the posts and the long sills."""
    leg = 0.06
    # corners (z, x), because along_y turns the first axis into z and the second axis into x
    triangle = np.array([(0.0, 0.0), (leg, 0.0), (0.0, leg)])
    bracket = mirror(along_y(extrude(triangle, -0.018, 0.018)), 0)
    bracket = move(bracket, FRAME_X - PROFILE, FRAME_Y - PROFILE / 2, PROFILE)
    return [piece for side in both_sides(bracket, 0) for piece in both_sides(side, 1)]


def _rail() -> list[np.ndarray]:
    rod = along_x(cylinder(ROD_RADIUS, -1.13, 1.13, 12))
    out = [move(rod, y=sy * ROD_Y, z=ROD_Z) for sy in (-1, 1)]
    # End blocks below the cross beams. The blocks carry the guide rods and, between the rods, the
    # belt pulleys.
    block = extrude(rounded_rectangle(-0.105, 0.105, 1.572, 1.66, 0.012, 2), 1.115, 1.14)
    out += both_sides(along_x(block), 0)
    # Side plates of the idler pulley, at the end of the rail opposite to the belt motor.
    cheek = box(-1.115, -0.99, 0.026, 0.034, 1.585, 1.66)
    out += both_sides(cheek, 1)
    # Lower and upper strand of the belt.
    out += [box(-1.06, 1.30, -0.0125, 0.0125, z - 0.001, z + 0.001) for z in (1.612, 1.653)]
    out.append(move(along_y(cylinder(0.02, -0.024, 0.024, 12)), -1.06, z=1.6325))
    return out


def _drive() -> list[np.ndarray]:
    """Build motor and gearbox at the end of the rail, with the shaft across the rail."""
    plate = rounded_corners(
        [(1.14, 1.575), (1.39, 1.585), (1.39, 1.665), (1.14, 1.66)], [0, 0.03, 0.03, 0], 3
    )
    # `plate` has coordinates (x, z), but along_y needs (z, x). Swapping them makes an outline
    # clockwise, so the order of its points is reversed, too.
    cheek = along_y(extrude(plate[:, ::-1][::-1], 0.016, 0.024))
    half = 0.0445
    gearbox = loft(
        [
            (rounded_rectangle(-s, s, -s, s, r, 2), y)
            for s, r, y in (
                (half - 0.006, 0.008, -0.06),
                (half, 0.01, -0.054),
                (half, 0.01, 0.05),
            )
        ]
    )
    # The steps of the motor's profile represent gaps between the parts of its casing.
    body, groove = half, half - 0.004
    profile = [(groove, 0.05), (groove, 0.058), (body, 0.058)]
    profile += [(body, 0.09), (groove, 0.09), (groove, 0.098), (body, 0.098)]
    profile += [(body, 0.25), (body - 0.003, 0.254)]
    motor = revolve(profile, 20)
    # along_y turns the first axis of the box into z, and the second axis into x.
    terminals = box(0.02, 0.05, -0.022, 0.022, 0.15, 0.22)
    boss = cylinder(0.01, 0.25, 0.258, 8)
    out = [move(along_y(p), MOTOR_X, z=MOTOR_Z) for p in (gearbox, motor, terminals, boss)]
    return [*out, *both_sides(cheek, 1)]


def slider() -> list[np.ndarray]:
    """Build the parts of the carriage in the frame of the link `slider`.

    The y axis of this frame is up, and its z axis is opposite to the x axis of the world.
    """
    # The parts are built about the joint origin, with z up and x along the rail, and then rotated
    # into the frame of the link.
    plate = loft(
        [
            (rounded_rectangle(-s, s, -s, s, 0.012, 2), z)
            for s, z in ((0.0742, -0.029), (0.0762, -0.027), (0.0762, -0.013))
        ]
    )
    bearing_outline = rounded_corners(
        [(-0.024, -0.013), (0.024, -0.013), (0.024, 0.03), (-0.024, 0.03)], [0, 0, 0.012, 0.012], 3
    )
    bearing = along_x(extrude(bearing_outline, 0.016, 0.07))
    parts = [plate]
    for sx in (0, 1):
        piece = mirror(bearing, 0) if sx else bearing
        parts += [move(piece, y=sy * ROD_Y) for sy in (-1, 1)]
    # The belt clamp consists of two uprights, between which the belt is visible, and a bridge.
    parts += [box(x, x + 0.01, -0.02, 0.02, -0.013, 0.032) for x in (-0.05, 0.04)]
    parts.append(box(-0.05, 0.05, -0.02, 0.02, 0.024, 0.032))
    # The jaws of the belt clamp hold the lower strand of the belt.
    parts.append(extrude(rectangle(-0.03, 0.03, -0.018, 0.018), -0.0185, -0.006))
    # Rotate the parts into the frame of the link. The -z, -x and y axes of this frame are the x, y
    # and z axes of the world.
    return [np.stack([-p[..., 1], p[..., 2], -p[..., 0]], axis=-1) for p in parts]
