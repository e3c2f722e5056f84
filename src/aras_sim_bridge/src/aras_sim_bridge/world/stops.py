"""Stops of joints in Bullet, for those that are put far beyond one.

Bullet takes a fifth of the distance back in one step: a joint that is spawned 0.8 rad beyond its
stop gets 160 rad/s, and an arm with light fingers flies apart. So the stop is brought near, and
moves back as fast as own steps bring such a joint back (joint_dynamics.py).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_sim_bridge.world.body import Body
from aras_sim_bridge.world.bullet import pybullet

_RETURN_SHARE = 0.2  # of the distance beyond a stop that Bullet takes back in a step


class JointStops:
    """The stops of the joints of a body.

    Args:
        indices: Bullet's of the joints. stops: (lower, upper) of each, rad or m, infinite where
            there is none. speeds: with which each returns from beyond them, rad/s or m/s.
    """

    def __init__(self, body: Body, indices: Sequence[int],
                 stops: Sequence[tuple[float, float]], speeds: Sequence[float]) -> None:
        self._body, self._indices = body, indices
        self._low, self._high = np.array(stops).reshape(-1, 2).T
        self._speeds = np.array(speeds)
        self._shifted_slots: set[int] = set()

    def before_step(self, positions: Sequence[float], dt: float) -> None:
        """Set the stops for a step of `dt` s from these positions."""
        at, most = np.array(positions), self._speeds * dt / _RETURN_SHARE
        low, high = np.minimum(self._low, at + most), np.maximum(self._high, at - most)
        far = {*np.flatnonzero((low < self._low) | (high > self._high)).tolist()}
        for slot in far | self._shifted_slots:
            pybullet.changeDynamics(
                self._body.body_id, self._indices[slot], jointLowerLimit=float(low[slot]),
                jointUpperLimit=float(high[slot]), physicsClientId=self._body.client)
        self._shifted_slots = far
