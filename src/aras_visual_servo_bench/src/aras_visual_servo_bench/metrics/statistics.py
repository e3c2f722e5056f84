"""Confidence intervals, and tests for the significance of differences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import scipy  # scipy.stats, which takes 0.5 s to import, is imported at its first use

CONFIDENCE = 0.95
RESAMPLES, BATCH = 2000, 200  # of the bootstrap; a batch limits its memory


@dataclass(frozen=True)
class Estimate:
    """A value with its confidence interval, NaN if unknown, and the number of samples (`count`)."""

    value: float
    low: float
    high: float
    count: int


def proportion(hits: int, count: int, confidence: float = CONFIDENCE) -> Estimate:
    """Estimate a rate with Wilson's interval, which is also valid near 0 and 1 and for few runs."""
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

    The resampling has a fixed seed, so a table is the same each time it is made.
    """
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if not known.size:
        return Estimate(np.nan, np.nan, np.nan, 0)
    middle = float(np.median(known))
    if known.size < 2 or np.ptp(known) == 0.0:
        return Estimate(middle, middle, middle, known.size)
    rng = np.random.default_rng(0)
    medians = [
        np.median(known[rng.integers(0, known.size, (BATCH, known.size))], axis=1)
        for _ in range(RESAMPLES // BATCH)
    ]
    outside = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(medians, (outside, 100.0 - outside))
    return Estimate(middle, float(low), float(high), known.size)


@dataclass(frozen=True)
class Comparison:
    """Comparison of two samples.

    before, after: rates, or medians of the finite values.
    p: probability of such a difference by chance.
    paired: True if runs are compared in pairs.
    count: number of runs or pairs that are compared.
    """

    before: float
    after: float
    p: float
    paired: bool
    count: int


def compare_rates(before: Sequence[float], after: Sequence[float], paired: bool) -> Comparison:
    """Compare successes (0 and 1) by McNemar's or Fisher's exact test.

    The first is for pairs, the second for other samples.
    """
    a, b = np.asarray(before, float), np.asarray(after, float)
    if paired:
        known = np.isfinite(a) & np.isfinite(b)
        a, b = a[known], b[known]
        better, worse = int((b > a).sum()), int((b < a).sum())
        p = float(scipy.stats.binomtest(better, better + worse).pvalue) if better + worse else 1.0
    else:
        a, b = a[np.isfinite(a)], b[np.isfinite(b)]
        counts = [[int(x.sum()), int(len(x) - x.sum())] for x in (a, b)]
        p = float(scipy.stats.fisher_exact(counts).pvalue) if len(a) and len(b) else 1.0
    return Comparison(_compute_mean(a), _compute_mean(b), p, paired, min(len(a), len(b)))


def compare_values(before: Sequence[float], after: Sequence[float], paired: bool) -> Comparison:
    """Compare values of a metric by the Wilcoxon signed-rank test or the Mann-Whitney U test.

    The first is for pairs, the second for other samples.
    """
    a, b = np.asarray(before, float), np.asarray(after, float)
    if paired:
        known = np.isfinite(a) & np.isfinite(b)
        a, b = a[known], b[known]
        differ = len(a) and not np.array_equal(a, b)
        p = float(scipy.stats.wilcoxon(b, a).pvalue) if differ else 1.0
    else:
        a, b = a[np.isfinite(a)], b[np.isfinite(b)]
        p = float(scipy.stats.mannwhitneyu(b, a).pvalue) if len(a) and len(b) else 1.0
    return Comparison(_compute_median(a), _compute_median(b), p, paired, min(len(a), len(b)))


def holm(p: Sequence[float]) -> list[float]:
    """Adjust p-values for multiple comparisons by Holm's step-down correction."""
    order = np.argsort(p)
    adjusted = np.zeros(len(p))
    worst = 0.0
    for rank, index in enumerate(order):
        worst = max(worst, min((len(p) - rank) * p[index], 1.0))
        adjusted[index] = worst
    return adjusted.tolist()


def _compute_mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


def _compute_median(values: np.ndarray) -> float:
    return float(np.median(values)) if values.size else float("nan")
