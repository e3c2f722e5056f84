"""Experiments with world files of users, and with the shipped one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from test_target_files import on_the_arm, seen

from aras_sim_bridge.description import world_file
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble

ROOT = Path(__file__).resolve().parents[3]
GAZEBO = ROOT / "src" / "aras_visual_servo_gazebo"
SMALL = {"width": 160, "height": 120, "horizontal_fov": 1.2}
STILL = {"friction": False, "duration": 0.2, "camera": SMALL}


def test_the_workbench_is_seen_all_around_the_target():
    table, *_ = seen(on_the_arm("l_shape", **STILL))
    bench, *_ = seen(on_the_arm("l_shape", world="workbench", **STILL))
    # The table is one grey; the bench has grain nearly everywhere.
    flat = [float((cv2.Laplacian(one.astype(float), cv2.CV_64F) == 0).mean())
            for one in (table, bench)]
    assert flat[0] > 0.8 and flat[1] < 0.3
    assert len(np.unique(bench)) > 60


def test_a_world_that_is_not_there_is_named():
    with pytest.raises(ExperimentError, match="did you mean 'workbench.world'"):
        assemble(on_the_arm("l_shape", world="workbemch", **STILL))


def test_grey_levels_lead_the_arm_home_on_the_workbench():
    poster = {"shape": "poster", "size": [0.12, 0.12], "pose": [0.05, 0.02, 0.5915, 0, 0, 0.3]}
    result = run(
        Experiment.from_mapping(
            {
                "world": "workbench",
                "scheme": "luminance",
                "target": poster,
                "time_after_convergence": 0.0,
                # with it the arm stands where rounding lets it, up to 0.7 mm off
                "friction": False,
                "camera": {**SMALL, "width": 80, "height": 60},
                "goal": [0.05, 0.0, -0.09, 0.045, 0.045, 0.0],
                "start": [0.055, 0.0, -0.085, 0.045, 0.045, 0.04],
            }
        )
    )
    # 80 by 60 pixels: where it ends is a matter of rounding, within what is left open.
    left = result.states[-1].arrival_status.pose_uncertainty.distance
    assert result.converged and result.verdict.distance < min(left, 1.5e-3)


def test_the_workbench_has_nothing_to_warn_of(caplog):
    world = world_file.load_world(str(GAZEBO / "world" / "workbench.world"),
                            lambda _: str(GAZEBO))
    assert world.warnings == () and not caplog.records
    assert (len(world.lights), world.scene.shadows, world.scene.sky) == (3, "hard", True)
