"""Gains by dynamic_reconfigure: an invalid gain changes nothing and is not clamped."""

from types import SimpleNamespace

import pytest

from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.laws.adaptive import Adaptive
from aras_visual_servo_controller.laws.sliding_mode import SlidingMode
from aras_visual_servo_controller.laws.wrappers import Ramp
from aras_visual_servo_controller.ros import reconfigure


@pytest.fixture
def served(monkeypatch):
    """Function that returns the fields and the callback of the GainServer of a law."""

    def serve(law):
        found = {}

        def server(namespace, fields, values, apply):
            found.update(fields={field.name: field for field in fields}, apply=apply)

        monkeypatch.setattr(reconfigure, "ReconfigureServer", server)
        monkeypatch.setattr(reconfigure.rospy, "resolve_name", lambda name: f"/node{name}")
        servo = SimpleNamespace(scheme=SimpleNamespace(law=law))
        driver = SimpleNamespace(servo=servo, apply_change=lambda change: change(servo))
        reconfigure.GainServer(SimpleNamespace(runner=driver))
        return found

    return serve


def test_gains_of_a_law_and_its_wrapper_are_changed_together_or_not_at_all(served):
    inside = Adaptive(5.0, 2.0, 30.0)
    law = Ramp(inside, 0.1)
    found = served(law)
    assert set(found["fields"]) == {"time", "zero", "infinity", "slope"}
    found["apply"]({"time": 0.2, "zero": 6.0, "infinity": 3.0, "slope": 20.0})
    assert (law.time, inside.zero, inside.infinity, inside.slope) == (0.2, 6.0, 3.0, 20.0)
    with pytest.raises(ConfigurationError, match="must be greater than the parameter infinity"):
        found["apply"]({"time": 0.4, "zero": 2.0, "infinity": 3.0, "slope": 20.0})
    assert (law.time, inside.zero, inside.infinity, inside.slope) == (0.2, 6.0, 3.0, 20.0)


def test_what_the_law_was_given_lies_within_what_may_be_set(served):
    """A client that sets one gain sends all; none of them may be moved into its limits."""
    fields = served(SlidingMode(400.0, 0.05, 5e-4))["fields"]
    for name, given in (("gain", 400.0), ("reach", 0.05), ("width", 5e-4)):
        assert fields[name].coerce(given) == given
    assert fields["gain"].coerce(5000.0) == 1000.0
    assert [fields[name].coerce(0.0) for name in ("reach", "width")] == [1e-3, 5e-4]
