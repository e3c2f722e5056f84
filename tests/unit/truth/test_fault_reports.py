"""Inconsistent reports of a long run are detected."""

import pytest

from faults.reports import Report, contradictions


def lasting(kind, begin, end):
    """Reports of an outcome at ten a second."""
    failed = kind != "running"
    return [Report(0.1 * k, kind, "why" * failed, "what" * failed)
            for k in range(round(10 * begin), round(10 * end))]  # fmt: skip


def test_reports_that_go_together_are_none():
    assert not contradictions([
        *lasting("running", 0, 1), *lasting("singular", 1, 3), *lasting("out_of_reach", 3, 6),
        Report(6.0, "converged up to 0.4 mm", "noise", "a larger target", "converged"),
    ])  # fmt: skip


@pytest.mark.parametrize(("reports", "why"), [
    ([Report(1.0, "singular", "", "other features")], "1.00 s: singular has the reason ''"),
    ([Report(1.0, "singular", "rank 2", "")], "and the remedy ''"),
    ([Report(2.0, "running", "", "begin nearer")], "running has the remedy 'begin nearer'"),
    (lasting("singular", 0, 2) + lasting("out_of_reach", 2, 2.5) + lasting("singular", 2.5, 4),
     "2.50 s: singular alternates with out_of_reach"),
])  # fmt: skip
def test_a_contradiction_is_found_with_its_time(reports, why):
    (found,) = contradictions(reports)
    assert why in found
