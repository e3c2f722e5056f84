"""Outcomes and reasons during a run: one cause at a time, with the matching numbers."""

from itertools import groupby

import pytest

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble


def reported(**keys):
    """The states of a run before the 2016 goal whose target is moved after 3 s."""
    experiment = Experiment.from_mapping({
        "plant": "chain", "features": "exact", "goal": "2016", "start": "2016", "duration": 9.0,
        "time_after_convergence": None, **keys,
    })  # fmt: skip
    loop, states = Loop(experiment, assemble(experiment)), []
    while not loop.is_over:
        if (state := loop.run_to_image()) is not None:
            states.append(state)
    loop.close()
    return states


@pytest.mark.parametrize(("scheme", "away"), [("moments", 0.01), ("points", 0.003)])
def test_a_target_just_beyond_reach_is_named_at_once_and_steadily(scheme, away):
    """The goal of 2016 lies 0.1 mm before the straight arm."""
    states = reported(scheme=scheme, target={"motion": {"step": [0, -away, 0], "begin": 3.0}})
    after = [state for state in states if state.stamp > 3.0]
    kinds = [kind for kind, _ in groupby(state.outcome.partition(" ")[0] for state in after)]
    assert kinds in (["converged", "running", "out_of_reach"], ["running", "out_of_reach"])
    first = next(state.stamp for state in after if state.outcome == "out_of_reach")
    assert first < 5.5
    for state in after:
        failed = state.outcome == "out_of_reach"
        assert state.reason.startswith("the arm is stretched") or not failed
        assert ("choose a goal within the arm's reach" in state.remedy) is failed
