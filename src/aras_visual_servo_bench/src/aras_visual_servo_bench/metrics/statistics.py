"""Confidence intervals, and tests for the significance of differences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy  # `import scipy` does not load scipy.stats, which takes 0.5 s, until it is used

CONFIDENCE = 0.95
# Number of resamples of the bootstrap, and number of resamples that are computed together.
RESAMPLES, BATCH = 2000, 200
# Largest number of pairs, or of values of both samples, with which a rank test is exact. An exact
# test of 50 values takes 8 ms. In 200 normal samples with p from 0.01 to 0.1, the normal
# approximation differed from the exact p by at most 7 %.
MAX_EXACT = 50
# The mantissas of differences are rounded to this number of decimals, so that differences that are
# equal up to rounding errors count as ties.
TIE_DIGITS = 9


@dataclass(frozen=True)
class Estimate:
    """A value with its confidence interval.

    value: estimated value; NaN if unknown.
    low, high: ends of the confidence interval; NaN if unknown.
    count: number of samples."""

    value: float
    low: float
    high: float
    count: int


def proportion(hits: int, count: int, confidence: float = CONFIDENCE) -> Estimate:
    """Estimate the rate hits / count with Wilson's interval.

    This interval is also valid for rates near 0 and 1, and for small counts."""
    if not count:
        return Estimate(np.nan, np.nan, np.nan, 0)
    rate, z = hits / count, NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    scale = 2.0 * (count + z * z)
    centre = (2.0 * hits + z * z) / scale
    half = z * math.sqrt(4.0 * hits * (1.0 - rate) + z * z) / scale
    low = 0.0 if hits == 0 else centre - half
    high = 1.0 if hits == count else centre + half
    return Estimate(rate, low, high, count)


def median(values: Sequence[float]) -> Estimate:
    """Estimate the median of the finite values with a percentile bootstrap interval.

    The bootstrap has a fixed seed, so the same values always give the same interval. A single value
    has no interval.
    """
    known = _select_finite(values)
    if not known.size:
        return Estimate(np.nan, np.nan, np.nan, 0)
    middle = float(np.median(known))
    if known.size == 1:
        return Estimate(middle, np.nan, np.nan, 1)
    if np.ptp(known) == 0.0:
        return Estimate(middle, middle, middle, known.size)
    rng = np.random.default_rng(0)
    medians = [
        np.median(known[rng.integers(0, known.size, (BATCH, known.size))], axis=1)
        for _ in range(RESAMPLES // BATCH)
    ]
    outside = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(medians, (outside, 100.0 - outside))
    return Estimate(middle, float(low), float(high), known.size)


def rate(values: Sequence[float]) -> Estimate:
    """Estimate the rate of 1 in samples of 0 and 1, with Wilson's interval; ignore NaN."""
    known = _select_finite(values)
    return proportion(int(known.sum()), known.size)


def quartiles(values: Sequence[float]) -> Estimate:
    """Return the median of the finite values, and their quartiles as lower and upper bound."""
    known = _select_finite(values)
    if not known.size:
        return Estimate(np.nan, np.nan, np.nan, 0)
    low, middle, high = np.quantile(known, [0.25, 0.5, 0.75])
    return Estimate(float(middle), float(low), float(high), known.size)


@dataclass(frozen=True)
class Comparison:
    """Comparison of two samples.

    before: rate, or median of the finite values, of the first sample.
    after: rate or median of the second sample.
    p: p-value: probability that chance alone gives at least such a difference; NaN if one of the
        samples is empty.
    paired: True if the samples are compared in pairs.
    counts: sizes of both samples; in pairs, both are the number of pairs.
    """

    before: float
    after: float
    p: float
    paired: bool
    counts: tuple[int, int]

    @property
    def count(self) -> int:
        """Number of pairs; for samples that are not paired, size of the smaller sample."""
        return min(self.counts)

    @property
    def least_p(self) -> float:
        """Lower bound of the p-values of the exact tests for samples of these sizes.

        It is 2 / 2^n for n pairs, 2 / binomial(2n, n) for two samples of equal size n, and 1 /
        binomial(n + m, n) for samples of different sizes n and m.
        """
        n, m = self.counts
        if self.paired:
            return min(2.0 * 2.0**-n, 1.0)
        return min((2.0 if n == m else 1.0) / scipy.special.comb(n + m, n), 1.0)


def compare_rates(before: Sequence[float], after: Sequence[float], paired: bool) -> Comparison:
    """Compare binary values (0 or 1) with McNemar's test in pairs, otherwise with Fisher's test.

    Both tests are exact.
    """
    a, b = np.asarray(before, float), np.asarray(after, float)
    if paired:
        known = np.isfinite(a) & np.isfinite(b)
        a, b = a[known], b[known]
        better, worse = int((b > a).sum()), int((b < a).sum())
        p = float(scipy.stats.binomtest(better, better + worse).pvalue) if better + worse else 1.0
        p = p if len(a) else np.nan
    else:
        a, b = a[np.isfinite(a)], b[np.isfinite(b)]
        counts = [[int(x.sum()), int(len(x) - x.sum())] for x in (a, b)]
        p = float(scipy.stats.fisher_exact(counts).pvalue) if len(a) and len(b) else np.nan
    return Comparison(_compute_mean(a), _compute_mean(b), p, paired, (len(a), len(b)))


def compare_values(before: Sequence[float], after: Sequence[float], paired: bool) -> Comparison:
    """Compare the values of a metric in two samples.

    The test is the Wilcoxon signed-rank test if the samples are paired, and otherwise the
    Mann-Whitney U test. Both are exact for small samples, even if values are equal; for large
    samples, they use the normal approximation. Pairs with equal values are omitted.
    """
    a, b = np.asarray(before, float), np.asarray(after, float)
    if paired:
        known = np.isfinite(a) & np.isfinite(b)
        a, b = a[known], b[known]
        p = _test_signed_ranks(b - a) if len(a) else np.nan
    else:
        a, b = a[np.isfinite(a)], b[np.isfinite(b)]
        p = _test_rank_sum(b, a) if len(a) and len(b) else np.nan
    return Comparison(_compute_median(a), _compute_median(b), p, paired, (len(a), len(b)))


def _test_signed_ranks(differences: np.ndarray) -> float:
    """Return the two-sided p-value of Wilcoxon's signed-rank test.

    The test statistic is the sum of the ranks of the positive differences. The exact p-value is the
    fraction of all assignments of signs to the ranks for which this sum is at least as far from its
    mean as the observed sum.
    """
    mantissas, exponents = np.frexp(differences[differences != 0.0])
    nonzero = np.ldexp(np.round(mantissas, TIE_DIGITS), exponents)
    if not nonzero.size:
        return 1.0
    if nonzero.size > MAX_EXACT:
        return float(scipy.stats.wilcoxon(nonzero, method="asymptotic").pvalue)
    ranks = _rank(np.abs(nonzero))
    fractions = np.ones(1)  # element s: fraction of the sign assignments with rank sum s
    for rank in ranks:
        fractions = 0.5 * (np.pad(fractions, (0, rank)) + np.pad(fractions, (rank, 0)))
    return _sum_tails(fractions, ranks[nonzero > 0.0].sum(), 0.5 * ranks.sum())


def _test_rank_sum(first: np.ndarray, second: np.ndarray) -> float:
    """Return the two-sided p-value of the Mann-Whitney U test.

    The test statistic is the rank sum of the first sample. The exact p-value is the fraction of all
    divisions of the values into two samples of these sizes for which this sum is at least as far
    from its mean as the observed sum.
    """
    values, count = np.concatenate([first, second]), len(first)
    if values.size > MAX_EXACT:
        return float(scipy.stats.mannwhitneyu(first, second, method="asymptotic").pvalue)
    ranks = _rank(values)
    # element (k, s): number of choices of k ranks whose sum is s
    choices = np.zeros((count + 1, ranks.sum() + 1))
    choices[0, 0] = 1.0
    for rank in ranks:
        choices[1:, rank:] += choices[:-1, : choices.shape[1] - rank].copy()
    fractions = choices[count] / choices[count].sum()
    return _sum_tails(fractions, ranks[:count].sum(), ranks.sum() * count / values.size)


def _rank(values: np.ndarray) -> np.ndarray:
    """Return twice the rank of each value.

    Equal values share their mean rank, which can be a half-integer; twice this rank is an integer.
    """
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (2 * np.cumsum(counts) - counts + 1)[index]


def _sum_tails(fractions: np.ndarray, observed: int, mean: float) -> float:
    """Add fractions[s] of all rank sums s that are at least as far from `mean` as `observed`."""
    distance = np.abs(np.arange(fractions.size) - mean)
    is_extreme = distance >= abs(observed - mean) * (1.0 - 1e-12)
    return min(float(fractions[is_extreme].sum()), 1.0)


def holm(p: Sequence[float]) -> list[float]:
    """Adjust p-values for multiple comparisons by Holm's step-down correction.

    A p-value that is NaN remains NaN and does not count as a comparison.
    """
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(np.asarray(p)[known])]
    adjusted = np.full(len(p), np.nan)
    worst = 0.0
    for rank, index in enumerate(order):
        worst = max(worst, min((len(known) - rank) * p[index], 1.0))
        adjusted[index] = worst
    return adjusted.tolist()


def _select_finite(values: Sequence[float]) -> np.ndarray:
    found = np.asarray(values, float)
    return found[np.isfinite(found)]


def _compute_mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


def _compute_median(values: np.ndarray) -> float:
    return float(np.median(values)) if values.size else float("nan")
