"""Gains of the law by dynamic_reconfigure, while it runs."""

from __future__ import annotations

import rospy

from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import Field, ReconfigureServer

from ..laws import Law
from ..servo import Servo
from .control import Owner

NAMESPACE = "~gains"
LEAST, GREATEST = 1e-3, 100.0


class GainServer:
    """One number for each gain of the law, also of the law inside a wrapper."""

    def __init__(self, owner: Owner) -> None:
        self._owner = owner
        gains = {name: getattr(law, name) for name, law in _laws(owner.driver.servo).items()}
        if not gains:
            return
        fields = [
            Field(name, "double", gain, LEAST, GREATEST, f"{name} of the law")
            for name, gain in gains.items()
        ]
        self._server = ReconfigureServer(rospy.resolve_name(NAMESPACE), fields, {}, self._apply)

    def _apply(self, values: dict[str, Value]) -> None:
        def change(servo: Servo) -> None:
            for name, law in _laws(servo).items():
                setattr(law, name, float(values[name]))

        self._owner.driver.change(change)


def _laws(servo: Servo) -> dict[str, Law]:
    """The law that each gain belongs to, by the gain's name."""
    laws: dict[str, Law] = {}
    law = getattr(servo.scheme, "law", None)
    while isinstance(law, Law):
        for name in law.gains:
            if isinstance(getattr(law, name, None), float):
                laws.setdefault(name, law)
        law = getattr(law, "law", None)
    return laws
