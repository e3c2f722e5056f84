"""Gains by dynamic_reconfigure: an invalid gain changes nothing and is not clamped."""

import pytest
from dynamic_reconfigure.msg import Config, DoubleParameter

from aras_visual_servo_controller.laws.adaptive import Adaptive
from aras_visual_servo_controller.laws.sliding_mode import SlidingMode
from aras_visual_servo_controller.laws.wrappers import Ramp
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver
from aras_visual_servo_controller.ros import reconfigure
from aras_visual_servo_controller.ros.controller_node import ControllerNode
from aras_visual_servo_controller.settings import ControllerSettings


@pytest.fixture
def served(graph, hear_with):
    """Function that serves the gains of a law; it returns what sets them, and their limits."""

    def serve(law):
        owner = ControllerNode(ControllerSettings(), {})
        owner.runner = hear_with(FeatureObserver(None))
        owner.runner.servo.scheme.law = law
        reconfigure.GainServer(owner)
        (described,) = graph.publishers["/unnamed/gains/parameter_descriptions"].sent

        def set_gains(**values):
            doubles = [DoubleParameter(*one) for one in values.items()]
            graph.call("/unnamed/gains/set_parameters", Config(doubles=doubles))

        limits = zip(described.min.doubles, described.max.doubles, strict=True)
        return set_gains, {low.name: (low.value, high.value) for low, high in limits}

    return serve


def test_gains_of_a_law_and_its_wrapper_are_changed_together_or_not_at_all(graph, served):
    inside = Adaptive(5.0, 2.0, 30.0)
    law = Ramp(inside, 0.1)
    set_gains, limits = served(law)
    assert set(limits) == {"time", "zero", "infinity", "slope"}
    set_gains(time=0.2, zero=6.0, infinity=3.0, slope=20.0)
    assert (law.time, inside.zero, inside.infinity, inside.slope) == (0.2, 6.0, 3.0, 20.0)
    set_gains(time=0.4, zero=2.0, infinity=3.0, slope=20.0)
    assert "must be greater than the parameter infinity" in graph.lines[-1]
    assert (law.time, inside.zero, inside.infinity, inside.slope) == (0.2, 6.0, 3.0, 20.0)


def test_what_the_law_was_given_lies_within_what_may_be_set(served):
    """A client that sets one gain sends all; none of them may be moved into its limits."""
    law = SlidingMode(400.0, 0.05, 5e-4)
    set_gains, limits = served(law)
    assert limits["gain"][1] == 1000.0
    assert (limits["reach"][0], limits["width"][0]) == (1e-3, 5e-4)
    set_gains(gain=400.0, reach=0.05, width=5e-4)
    assert (law.gain, law.reach, law.width) == (400.0, 0.05, 5e-4)
