"""The schemes of docs/examples in the runner: simulated arms, rendered pictures, one name."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_controller.goals.goal import Goal

ROOT = Path(__file__).parents[3]
GOAL = Goal.load(ROOT / "src/aras_visual_servo_controller/config/goal_2016.yaml")
AWAY = np.array([-0.1, 0.0, 0.349, -0.262, -0.0873, 0.1745])
# From which part of the way: the grey levels of the whole picture have a narrow valley. The two
# others of docs/examples run in the gallery.
SCHEMES = {"photometric:Photometric": 0.1, "second_order:SecondOrder": 1.0}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_users_scheme_reaches_its_goal_by_its_name_alone(scheme, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "examples"))
    joints = np.array([GOAL.joints[name] for name in ("gantry", "J1", "J2", "J3", "J5", "J6")])
    start = joints + SCHEMES[scheme] * (AWAY - joints)
    result = run(
        Experiment(
            scheme=scheme, start=tuple(start.tolist()), goal="2016", time_after_convergence=0.1
        )
    )
    # What the pictures leave open is about the 0.3 mm from which on it is said.
    assert result.converged and result.verdict.is_reached, (result.outcome, result.verdict)
    assert result.compute_settling_time() < 1.2


@pytest.mark.parametrize("scheme", ["eye_to_hand:EyeToHand", "stereo_ibvs:StereoIBVS"])
def test_a_users_scheme_of_cameras_that_stand(scheme, monkeypatch):
    """On the arm without dynamics; docs/several_cameras.md has the simulated one."""
    monkeypatch.chdir(ROOT / "docs" / "examples")
    monkeypatch.syspath_prepend(".")
    result = run(Experiment.from_yaml("portal.yaml").with_changes(scheme=scheme, plant="chain"))
    assert result.outcome == "converged" and result.verdict.is_reached, result.reason
    assert set(result.outcomes) == {"running", "converged"}
    assert result.compute_settling_time() < 1.5
    source = Path(f"{scheme.partition(':')[0]}.py").read_text()
    assert len(source.splitlines()) < 60
