"""Gains of the law by dynamic_reconfigure, while it runs."""

from __future__ import annotations

from types import SimpleNamespace

import rospy
from dynamic_reconfigure.encoding import Config
from dynamic_reconfigure.server import Server

from ..laws import Law
from ..servo import Servo
from .control import Owner

NAMESPACE = "~gains"
GREATEST = 100.0


class GainServer:
    """One number for each gain of the law, also of the law inside a wrapper."""

    def __init__(self, owner: Owner) -> None:
        self._owner = owner
        laws = _laws(owner.driver.servo)
        if not laws:
            return
        if rospy.has_param(NAMESPACE):
            rospy.delete_param(NAMESPACE)  # what an earlier run was set to
        self._server = Server(_kind(laws), self._apply, NAMESPACE)

    def _apply(self, config: Config, _: int) -> Config:
        def change(servo: Servo) -> None:
            for name, law in _laws(servo).items():
                setattr(law, name, float(config[name]))

        self._owner.driver.change(change)
        return config


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


def _kind(laws: dict[str, Law]) -> SimpleNamespace:
    """What dynamic_reconfigure generates from a .cfg file, for gains known only now."""
    parameters = [
        {
            "name": name, "type": "double", "level": 1, "edit_method": "",
            "description": f"{name} of the law", "default": getattr(law, name),
            "min": 1e-3, "max": GREATEST,
        }
        for name, law in laws.items()
    ]  # fmt: skip
    group = {
        "name": "Default", "type": "", "state": True, "cstate": "true", "id": 0, "parent": 0,
        "parentname": "", "parentclass": "", "class": "DEFAULT", "field": "default",
        "upper": "DEFAULT", "lower": "groups", "parameters": parameters, "groups": [],
    }  # fmt: skip
    return SimpleNamespace(
        config_description=group,
        defaults=Config({name: getattr(law, name) for name, law in laws.items()}),
        min=Config(dict.fromkeys(laws, 1e-3)),
        max=Config(dict.fromkeys(laws, GREATEST)),
        level=dict.fromkeys(laws, 1),
    )
