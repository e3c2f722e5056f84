"""Joint stops in Bullet, which are shifted for joints that start far beyond a stop.

In each step, Bullet corrects a fifth of a joint's distance beyond its stop. A joint that is spawned
0.8 rad beyond its stop would get a speed of 160 rad/s, and an arm with light fingers would break
apart. Therefore the stop is first moved close to the joint. Then the stop is moved back gradually,
so that the joint returns at the same speed as in joint_dynamics.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_sim_bridge.world.bullet_body import BulletBody

# fraction of a joint's distance beyond its stop that Bullet corrects in each step
_RETURN_SHARE = 0.2


class JointStops:
    """Stops of the joints of a body.

    Args:
        body: the body.
        indices: Bullet's indices of the joints.
        stops: lower and upper stop of each joint, rad or m; infinite for a missing stop.
        speeds: speed at which each joint returns from beyond its stops, rad/s or m/s.
    """

    def __init__(self, body: BulletBody, indices: Sequence[int],
                 stops: Sequence[tuple[float, float]], speeds: Sequence[float]) -> None:
        self._body, self._indices = body, indices
        self._low, self._high = np.array(stops).reshape(-1, 2).T
        self._speeds = np.array(speeds)
        self._shifted_slots: set[int] = set()

    def before_step(self, positions: Sequence[float], dt: float) -> None:
        """Set the stops in Bullet for a step of `dt` s, from the positions of the joints."""
        at, most = np.array(positions), self._speeds * dt / _RETURN_SHARE
        low, high = np.minimum(self._low, at + most), np.maximum(self._high, at - most)
        far = {*np.flatnonzero((low < self._low) | (high > self._high)).tolist()}
        for slot in far | self._shifted_slots:
            self._body.change_joint(self._indices[slot], jointLowerLimit=float(low[slot]),
                                    jointUpperLimit=float(high[slot]))
        self._shifted_slots = far
