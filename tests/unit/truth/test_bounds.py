"""The uncertainty that `converged` reports is not exceeded, and not much wider than the error."""

import numpy as np
import pytest

from outcome_campaign.trial import carried_out

OUTLINE = np.array([[-0.05, -0.03], [0.04, -0.05], [0.05, 0.05], [-0.015, 0.035]])
KEYS = {
    "plant": "free", "features": "images", "duration": 12.0, "time_after_convergence": 0.5,
    "start": {"height": [0.2, 0.32], "side": 0.03, "turn": 0.25},
}  # fmt: skip


def run_one(scheme: str, seed: int, **keys) -> float:
    """Return the ratio of the reported uncertainty to the true error, the smaller one of both."""
    keys = {**KEYS, **keys, "scheme": scheme, "seed": seed, "gain": 1.5 + 0.1 * seed}
    run, outcome = carried_out(keys)
    assert outcome.kind.startswith("converged"), outcome.reason
    distance = outcome.open_distance / run.verdict.distance
    return min(distance, outcome.open_angle / run.verdict.angle)


def test_moments_with_a_computed_goal():
    """A goal that is computed from the geometry has no error; the image alone has one."""
    ratios = [run_one("moments", seed) for seed in range(5)]
    assert min(ratios) >= 1.0
    assert np.median(ratios) <= 4.5, ratios


@pytest.mark.parametrize("scheme", ["points", "segments"])
def test_corners_with_a_goal_of_the_same_camera(scheme):
    """Outlines of 28 to 164 px, each at another angle in the image."""
    random, ratios = np.random.default_rng(1), []
    for seed in range(4):
        outline = OUTLINE * random.uniform(0.6, 2.5) + random.uniform(-0.008, 0.008, (4, 2))
        target = {"shape": outline.round(5).tolist(),
                  "pose": [0.0, 0.0, 0.59, 0.0, 0.0, float(random.uniform(-3.0, 3.0))]}  # fmt: skip
        ratios.append(run_one(scheme, seed, target=target))
    assert min(ratios) >= 1.0
    assert np.median(ratios) <= 8.0, ratios
