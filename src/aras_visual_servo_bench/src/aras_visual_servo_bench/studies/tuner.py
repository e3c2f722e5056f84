"""Searches settings that make a metric best, by SciPy's differential evolution over a study.

Every generation is a study of its own in a folder of its own: its candidates are the cases, and
all meet the same starts and the same noise. So a search that was broken off goes on where it was,
and every run of it can be looked at.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import NonlinearConstraint, differential_evolution
from scipy.stats import qmc

from ..errors import StudyError
from ..experiment.experiment_keys import check_key
from ..metrics import metrics as known_metrics
from ..metrics.metrics import GREATER, Metric
from .results import Results
from .study import Study

LOGARITHMIC_RATIO = 10.0  # ranges of this factor or more are searched by factors
DIGITS = 6
MIN_CANDIDATES = 8  # candidates a generation


@dataclass(frozen=True)
class SearchRange:
    """A key and the ends between which its value is looked for."""

    key: str
    low: float
    high: float

    def __post_init__(self) -> None:
        check_key(self.key)
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise StudyError(f"{self.key}={self.low:g}:{self.high:g} is no range: it must rise")

    @classmethod
    def parse(cls, text: str) -> SearchRange:
        """Of `key=low:high`; StudyError where it is none."""
        key, _, ends = text.partition("=")
        try:
            low, high = map(float, ends.split(":"))
        except ValueError:
            raise StudyError(f"'{text}' is no range: write key=low:high, gain=0.5:8") from None
        return cls(key, low, high)

    def interpolate(self, unit: float) -> float:
        """The value at a part from 0 to 1 of the range, in few digits."""
        if self.low > 0.0 and self.high / self.low >= LOGARITHMIC_RATIO:
            found = self.low * (self.high / self.low) ** unit
        else:
            found = self.low + unit * (self.high - self.low)
        return min(max(float(f"{found:.{DIGITS}g}"), self.low), self.high)


@dataclass(frozen=True)
class Candidate:
    """Settings that were tried. values: of the ranges. cost: mean of the metric, smaller is better.

    violation: 0 where nothing left the image and enough runs succeeded. success: part of the runs.
    excursion: the farthest of all, in half sizes of the image.
    """

    values: tuple[float, ...]
    cost: float
    violation: float
    success: float
    excursion: float


class Tuner:
    """A search under way. tried: all candidates so far, in order."""

    def __init__(
        self, study: Study, ranges: Sequence[SearchRange], metric: str, out: Path,
        carry_out: Callable[[Study, Path], None], min_success: float = 1.0,
    ) -> None:  # fmt: skip
        """Of a study whose own runs every candidate meets.

        Args:
            metric: name of what is to be best. needed: part of the runs that must succeed.
            carry_out: runs a study into a folder.

        Raises:
            StudyError: a key that varies already or is given twice, or nothing to look for.
        """
        if not ranges:
            raise StudyError("say what is looked for: --over key=low:high")
        keys = [r.key for r in ranges]
        for key in keys:
            if key in study.keys or keys.count(key) > 1:
                raise StudyError(f"'{key}' is given twice: by the study or by two ranges")
        if study.cases:
            raise StudyError("a study with cases cannot be tuned: put them under vary")
        if not 0.0 <= min_success <= 1.0:
            raise StudyError(f"the part that must succeed is {min_success:g}, must be from 0 to 1")
        self._metric: Metric = known_metrics.find_metric(metric)
        watched = (known_metrics.success.name, known_metrics.image_excursion.name, metric)
        self._study = dataclasses.replace(
            study, seeds="repeats", metrics=tuple(dict.fromkeys((*study.metrics, *watched)))
        )
        self._ranges, self._out, self._min_success = tuple(ranges), out, min_success
        self._carry_out = carry_out
        self._cached_candidates: dict[tuple[float, ...], Candidate] = {}
        self._generations = 0

    @property
    def candidates(self) -> list[Candidate]:
        """All candidates, in the order in which they were tried."""
        return list(self._cached_candidates.values())

    def search(self, evaluations: int) -> Candidate:
        """The best of about so many candidates.

        Raises:
            StudyError: too few to search with.
        """
        size = max(MIN_CANDIDATES, 4 * len(self._ranges))
        generations = evaluations // size - 1
        if generations < 1:
            raise StudyError(f"{evaluations} evaluations are too few: {2 * size} are two rounds")
        rng = np.random.default_rng(self._study.seed)
        first = qmc.LatinHypercube(len(self._ranges), rng=rng).random(size)
        # The constraint is asked first, and for all; both answers come from the same runs.
        differential_evolution(
            lambda x: np.array([c.cost for c in self._evaluate(x.T)]),
            [(0.0, 1.0)] * len(self._ranges),
            constraints=NonlinearConstraint(
                lambda x: np.array([[c.violation for c in self._evaluate(x.T)]]), -np.inf, 0.0
            ),
            init=first, maxiter=generations, tol=0.0, polish=False, updating="deferred",
            vectorized=True, rng=rng,
        )  # fmt: skip
        return self.best

    @property
    def best(self) -> Candidate:
        """The cheapest that violates nothing, or what violates least."""
        return min(self._cached_candidates.values(), key=lambda c: (c.violation, c.cost))

    def write(self) -> Path:
        """best.yaml, the settings found, and candidates.csv beside it."""
        keys = [r.key for r in self._ranges]
        self._out.mkdir(parents=True, exist_ok=True)
        with open(self._out / "candidates.csv", "w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*keys, self._metric.name, "violation", "success", "image_excursion"])
            for c in self.candidates:
                writer.writerow([*c.values, c.cost, c.violation, c.success, c.excursion])
        found = dict(zip(keys, self.best.values, strict=True))
        (self._out / "best.yaml").write_text(yaml.safe_dump(found, sort_keys=False))
        return self._out / "best.yaml"

    def _evaluate(self, units: np.ndarray) -> list[Candidate]:
        """Candidates of rows (n, k) of parts from 0 to 1, run if they are new."""
        rows = np.atleast_2d(units)
        wanted = [
            tuple(r.interpolate(u) for r, u in zip(self._ranges, row, strict=True))
            for row in rows.tolist()
        ]
        new = [values for values in dict.fromkeys(wanted) if values not in self._cached_candidates]
        if new:
            self._run(new)
        return [self._cached_candidates[values] for values in wanted]

    def _run(self, new: Sequence[tuple[float, ...]]) -> None:
        keys = [r.key for r in self._ranges]
        cases = tuple(dict(zip(keys, values, strict=True)) for values in new)
        path = self._out / f"generation-{self._generations:03d}"
        self._generations += 1
        self._carry_out(dataclasses.replace(self._study, cases=cases), path)
        results = Results.read(path)
        success = results.compute_successes()
        excursion = results.read_numbers(known_metrics.image_excursion.name)
        measured = results.read_numbers(self._metric.name)
        sign = -1.0 if self._metric.better == GREATER else 1.0
        for values, rows in results.group_rows(keys).items():
            known = measured[rows][np.isfinite(measured[rows])]
            rate = float(success[rows].mean())
            # What was refused or died has shown nothing, least of all that it stays in view.
            worst = float(np.max(np.where(np.isnan(excursion[rows]), np.inf, excursion[rows])))
            self._cached_candidates[values] = Candidate(
                values, sign * float(known.mean()) if known.size else np.inf,
                min(max(worst - 1.0, 0.0), 10.0) + max(self._min_success - rate, 0.0), rate, worst,
            )  # fmt: skip
