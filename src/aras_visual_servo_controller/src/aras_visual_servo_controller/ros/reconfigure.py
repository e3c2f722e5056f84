"""Parameters of dynamic_reconfigure for the gains of the control law."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rospy

from aras_visual_servo_base.registry import list_parameters
from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import ReconfigurableParameter, ReconfigureServer

from ..errors import ConfigurationError
from ..laws import Law
from ..laws.base import MAX_GAIN
from ..loop.servo import Servo

if TYPE_CHECKING:
    from .loop_services import LoopOwner

NAMESPACE = "~gains"
MIN_GAIN = 1e-3  # lower bound of gains that clients can set, unless the configured gain is smaller


class GainServer:
    """Server of dynamic_reconfigure with one number for each gain of the law.

    The gains of a wrapped law are included.
    """

    def __init__(self, owner: LoopOwner) -> None:
        self._owner = owner
        laws = _find_laws(owner.runner.servo)
        if not laws:
            return
        fields = []
        for name, law in laws.items():
            value = getattr(law, name)
            help = next(p.help for p in list_parameters(type(law)) if p.name == name)
            fields.append(ReconfigurableParameter(
                name, "double", value, min(MIN_GAIN, value), max(MAX_GAIN, value),
                help or f"{name} of the law",
            ))  # fmt: skip
        self._server = ReconfigureServer(rospy.resolve_name(NAMESPACE), fields, {}, self._apply)

    def _apply(self, values: dict[str, Value]) -> None:
        self._owner.runner.apply_change(lambda servo: set_gains(servo, values))


def set_gains(servo: Servo, values: dict[str, Value]) -> None:
    """Change the gains of the loop's laws, either all of them or none.

    Raises:
        ConfigurationError: a law does not accept a value; all gains then keep their old values.
    """
    gains: dict[Law, dict[str, float]] = {}
    for name, law in _find_laws(servo).items():
        gains.setdefault(law, {})[name] = float(values[name])
    before = {law: {name: getattr(law, name) for name in given} for law, given in gains.items()}
    try:
        for law, given in gains.items():
            law.set_parameters(**given)
    except ConfigurationError:
        for law, given in before.items():
            law.set_parameters(**given)
        raise


def _find_laws(servo: Servo) -> dict[str, Law]:
    """Return the law to which each gain belongs, by the name of the gain."""
    laws: dict[str, Law] = {}
    law = getattr(servo.scheme, "law", None)
    while isinstance(law, Law):
        for name in law.list_tunable_parameters():
            laws.setdefault(name, law)
        law = getattr(law, "law", None)
    return laws
