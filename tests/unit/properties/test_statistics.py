"""Intervals and tests: properties that hold for any numbers."""

import itertools
import math

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from aras_visual_servo_bench.metrics import statistics

NUMBERS = st.floats(-1e6, 1e6) | st.just(math.nan) | st.integers(-3, 3).map(float)
SAMPLES = st.lists(NUMBERS, max_size=25)
PAIRS = st.lists(st.tuples(NUMBERS, NUMBERS), max_size=25)
RATES = st.lists(st.tuples(*[st.sampled_from([0.0, 1.0, math.nan])] * 2), max_size=40)


@given(st.integers(0, 400), st.integers(0, 400))
def test_a_rate_lies_in_its_interval_and_that_from_0_to_1(hits, misses):
    count = hits + misses
    found = statistics.proportion(hits, count)
    if not count:
        assert math.isnan(found.value) and found.count == 0
        return
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0
    assert found.value == hits / count and found.count == count
    mirrored = statistics.proportion(misses, count)
    assert (1.0 - mirrored.high, 1.0 - mirrored.low) == pytest.approx((found.low, found.high))
    surer = statistics.proportion(hits, count, 0.5)
    assert found.low <= surer.low and surer.high <= found.high
    for confidence in (0.5, 0.95, 0.999):
        other = scipy.stats.binomtest(hits, count).proportion_ci(confidence, method="wilson")
        found = statistics.proportion(hits, count, confidence)
        assert (found.low, found.high) == pytest.approx(tuple(other), abs=1e-12)


@settings(max_examples=25)
@given(SAMPLES)
def test_a_median_is_that_of_what_is_known_and_the_same_each_time(values):
    found, known = statistics.median(values), [v for v in values if math.isfinite(v)]
    assert found.count == len(known)
    if not known:
        assert math.isnan(found.value)
        return
    assert found.value == np.median(known)
    assert min(known) <= found.value <= max(known)
    if len(known) == 1:  # no interval
        assert math.isnan(found.low) and math.isnan(found.high)
        return
    assert min(known) <= found.low <= found.value <= found.high <= max(known)
    assert statistics.median(values) == found
    if len(known) > 1 and np.ptp(known):
        other = scipy.stats.bootstrap(
            (known,), np.median, n_resamples=statistics.RESAMPLES, method="percentile",
            rng=np.random.default_rng(0), batch=statistics.BATCH,
        )  # fmt: skip
        assert (found.low, found.high) == tuple(other.confidence_interval)


@given(RATES)
def test_rates_of_pairs_are_compared_by_the_pairs_that_differ(pairs):
    before, after = [a for a, _ in pairs], [b for _, b in pairs]
    found = statistics.compare_rates(before, after, True)
    whole = [(a, b) for a, b in pairs if not math.isnan(a + b)]
    assert found.count == len(whole) and found.paired
    back = statistics.compare_rates(after, before, True)
    assert back.p == pytest.approx(found.p, nan_ok=True)
    assert (back.before, back.after) == pytest.approx((found.after, found.before), nan_ok=True)
    better, worse = sum(b > a for a, b in whole), sum(b < a for a, b in whole)
    n = better + worse
    tail = sum(math.comb(n, k) for k in range(min(better, worse) + 1)) / 2**n
    if not whole:
        assert math.isnan(found.p)
        return
    assert found.p == pytest.approx(min(1.0, 2.0 * tail))
    if whole:
        assert found.before == pytest.approx(np.mean([a for a, _ in whole]))


@given(PAIRS, st.permutations(range(25)))
def test_the_order_of_runs_and_what_is_unknown_tell_nothing(pairs, order):
    order = [k for k in order if k < len(pairs)]
    mixed = [pairs[k] for k in order]
    whole = [(a, b) for a, b in pairs if math.isfinite(a + b)]
    for paired, kept in ((True, whole), (False, pairs)):
        found, other = (
            statistics.compare_values([a for a, _ in some], [b for _, b in some], paired)
            for some in (mixed, kept)
        )
        assert 0.0 <= found.p <= 1.0 or math.isnan(found.p) and found.count == 0
        assert found.count == other.count
        assert (found.before, found.after, found.p) == pytest.approx(
            (other.before, other.after, other.p), nan_ok=True)


@pytest.mark.parametrize("paired", [True, False])
@pytest.mark.parametrize("compare", [statistics.compare_rates, statistics.compare_values])
def test_of_what_is_unknown_nothing_can_be_told(compare, paired):
    for before, after in (([], []), ([1.0], [math.nan]), ([math.nan], [0.0])):
        found = compare(before, after, paired)
        assert math.isnan(found.p) and found.count == 0


def count_extremes(sums, observed, mean):
    distances = np.abs(np.array(sums) - mean)
    return np.mean(distances >= abs(observed - mean) - 1e-9)


TIED = st.integers(-2, 3).map(float) | st.integers(0, 9).map(lambda n: 0.1 * n)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(TIED, TIED), min_size=1, max_size=9))
def test_signed_ranks_are_counted_over_all_signs(pairs):
    before, after = np.array(pairs).T
    differences = np.round(after - before, 9)
    differences = differences[differences != 0.0]
    ranks = scipy.stats.rankdata(np.abs(differences))
    sums = [np.dot(ranks, signs) for signs in itertools.product([0, 1], repeat=len(ranks))]
    expected = count_extremes(sums, ranks[differences > 0.0].sum(), 0.5 * ranks.sum())
    assert statistics.compare_values(before, after, True).p == pytest.approx(expected)


@settings(max_examples=60, deadline=None)
@given(st.lists(TIED, min_size=1, max_size=5), st.lists(TIED, min_size=1, max_size=5))
def test_rank_sums_are_counted_over_all_choices(before, after):
    ranks, count = scipy.stats.rankdata(np.round([*before, *after], 9)), len(before)
    sums = [sum(chosen) for chosen in itertools.combinations(ranks, count)]
    expected = count_extremes(sums, ranks[:count].sum(), ranks.sum() * count / len(ranks))
    assert statistics.compare_values(before, after, False).p == pytest.approx(expected)


@pytest.mark.parametrize("count", [20, 25, 26, 60, 3000])
def test_rank_tests_are_those_of_scipy_without_ties(count):
    rng = np.random.default_rng(count)
    before, after = rng.normal(size=count), rng.normal(0.3, size=count)
    paired, alone = (statistics.compare_values(before, after, one) for one in (True, False))
    method = ["exact" if size <= 50 else "asymptotic" for size in (count, 2 * count)]
    expected = scipy.stats.wilcoxon(after, before, method=method[0]).pvalue
    assert paired.p == pytest.approx(expected, rel=1e-9)
    expected = scipy.stats.mannwhitneyu(after, before, method=method[1]).pvalue
    assert alone.p == pytest.approx(expected, rel=1e-9)
    assert paired.least_p <= paired.p and alone.least_p <= alone.p
    assert (paired.least_p == 0.0) == (count == 3000)


@pytest.mark.parametrize("sizes", [*itertools.product(range(1, 5), range(1, 5))])
def test_least_p_is_the_smallest_p_of_binary_samples(sizes):
    one, two = ([1.0] * sizes[0], [0.0] * sizes[1])
    for compare in (statistics.compare_rates, statistics.compare_values):
        found = compare(one, two, False)
        assert found.least_p == pytest.approx(found.p)


@given(st.lists(st.floats(0.0, 1.0), max_size=12))
def test_holm_is_the_step_down_of_its_definition(p):
    """What was not tested is no comparison."""
    *found, unknown = statistics.holm([*p, math.nan])
    assert math.isnan(unknown)
    ranked = sorted(range(len(p)), key=lambda k: p[k])
    for rank, k in enumerate(ranked):
        steps = [(len(p) - j) * p[i] for j, i in enumerate(ranked[: rank + 1])]
        assert found[k] == pytest.approx(min(1.0, max(steps)))
        assert p[k] <= found[k] <= 1.0
