"""The loop of docs/examples, written out: its error decays as the textbook's does."""

from pathlib import Path

import numpy as np


def test_the_example_arrives_by_the_commanded_decay(monkeypatch, capsys):
    """Per image, e changes by -1.5 / 30 of itself; 30 images lie between two lines."""
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs" / "examples")
    import four_points

    assert four_points.main() < 5e-6
    errors = [float(line.split()[-1]) for line in capsys.readouterr().out.splitlines()[:-1]]
    assert len(errors) == 8
    ratios = np.divide(errors[1:5], errors[:4])
    np.testing.assert_allclose(ratios, (1.0 - 1.5 / 30.0) ** 30, rtol=0.015)
