"""Gripping and slipping between two fingers, compared with Coulomb's law."""

from __future__ import annotations

from collections.abc import Iterator
from math import dist

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.world import Model, Pose, World

from .check import Row, check

G, MASS, STEP = 9.8, 0.2, 1e-3
_HIGH = 0.5  # m

_FINGER = """<link name="{name}"><inertial><mass value="0.1"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.03 0.01 0.08"/></geometry></collision></link>
<joint name="close_{name}" type="prismatic"><parent link="world"/><child link="{name}"/>
<origin xyz="0 {y} {z}"/><axis xyz="0 {along} 0"/>
<limit lower="-0.1" upper="0.1" effort="50" velocity="1"/></joint>
<gazebo reference="{name}"><mu1>{mu}</mu1></gazebo>"""

_BOX = """<robot name="box"><link name="box"><inertial><mass value="{mass}"/>
<inertia ixx="9e-5" iyy="9e-5" izz="6e-5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.04 0.04 0.06"/></geometry></collision></link>
<gazebo reference="box"><mu1>{mu}</mu1></gazebo></robot>"""


def _gripped(world: World, mu: float, tilt: float, aside: float) -> tuple[Model, Model]:
    """Spawn a hand with two fingers and a box between them, `aside` [m] from their centres."""
    fingers = "".join(_FINGER.format(name=name, y=0.025 * sign, z=_HIGH, along=-sign, mu=mu)
                      for name, sign in (("left", 1.0), ("right", -1.0)))
    hand = parse_urdf(f'<robot name="hand"><link name="world"/>{fingers}</robot>')
    box = parse_urdf(_BOX.format(mass=MASS, mu=mu))
    start = Pose.from_rpy((aside, 0.0, _HIGH), (0.0, tilt, 0.0))
    return world.spawn(hand, "hand"), world.spawn(box, "box", start)


def _steps(world: World, hand: Model, press: float, count: int) -> None:
    for _ in range(count):
        for joint in hand.joint_names:
            hand.apply_effort(joint, press)
        world.step()


@check("Coulomb's law")
def gripping() -> Iterator[Row]:
    """Hold a box of 0.2 kg between two fingers for 10 s, upright and tilted; let another slip."""
    for mu, press, tilt in ((0.5, 10.0, 0.0), (0.5, 10.0, 0.4), (1.0, 3.0, 0.2)):
        with World() as world:
            hand, box = _gripped(world, mu, tilt, 0.005)
            _steps(world, hand, press, 200)
            first = box.pose()
            _steps(world, hand, press, 10_000)
            last = box.pose()
        what = f"gripping force {press:g} N, friction {mu:g}, tilted by {tilt:g} rad"
        slid = dist(first.xyz[::2], last.xyz[::2])
        yield Row(f"{what}: displacement in 10 s", "none", 1e3 * slid, 0.1, "mm")
    mu, press = 0.2, 3.0
    with World() as world:
        # Hold the box at the centre of the fingers: elsewhere it also rotates, and friction is
        # not vertical.
        hand, box = _gripped(world, mu, 0.0, 0.0)
        _steps(world, hand, press, 50)
        before = box.twist().linear[2]
        _steps(world, hand, press, 20)
        found = (before - box.twist().linear[2]) / (20 * STEP)
    expected = G - 2.0 * mu * press / MASS
    yield Row("acceleration while slipping", f"{expected:.3g} m/s²",
              abs(found / expected - 1.0), 0.02)
