"""Find settings that optimize a metric of a study, with SciPy's differential evolution.

Every generation is a study of its own, in its own folder. The cases of this study are the
candidates of the generation; all candidates have the same starts and noise. Therefore an
interrupted search can be continued, and every run can be inspected.
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
from ..metrics.metric import GREATER, Metric
from .results import Results
from .study import Study

# Ratio high/low of a search range from which its values are on a logarithmic scale.
LOGARITHMIC_RATIO = 10.0
DIGITS = 6  # number of significant digits of the settings of a candidate
MIN_CANDIDATES = 8  # minimum number of candidates per generation


@dataclass(frozen=True)
class SearchRange:
    """Range of values of a setting in which the best value is searched."""

    key: str
    low: float
    high: float

    def __post_init__(self) -> None:
        check_key(self.key)
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise StudyError(
                f"{self.key}={self.low:g}:{self.high:g} is not a range: give finite ends with "
                "low < high"
            )

    @classmethod
    def parse(cls, text: str) -> SearchRange:
        """Parse a search range of the form `key=low:high`.

        Raises:
            StudyError: the text does not have this form.
        """
        key, _, ends = text.partition("=")
        try:
            low, high = map(float, ends.split(":"))
        except ValueError:
            raise StudyError(
                f"'{text}' is not a range: write key=low:high, such as gain=0.5:8"
            ) from None
        return cls(key, low, high)

    def interpolate(self, unit: float) -> float:
        """Return the value at a fraction (0 to 1) of the range, rounded to DIGITS digits."""
        if self.low > 0.0 and self.high / self.low >= LOGARITHMIC_RATIO:
            value = self.low * (self.high / self.low) ** unit
        else:
            value = self.low + unit * (self.high - self.low)
        return min(max(float(f"{value:.{DIGITS}g}"), self.low), self.high)


@dataclass(frozen=True)
class Candidate:
    """Settings that were tried, and their results.

    values: value of each searched key.
    cost: mean of the metric, with a sign such that smaller is better.
    violation: 0 if the target stayed in the image and enough runs succeeded; positive otherwise.
    success: success rate.
    excursion: largest offset of a target corner from the image centre in any run, in half image
        widths or heights.
    """

    values: tuple[float, ...]
    cost: float
    violation: float
    success: float
    excursion: float


class Tuner:
    """Search for settings that optimize a metric of a study."""

    def __init__(
        self, study: Study, ranges: Sequence[SearchRange], metric: str, out: Path,
        carry_out: Callable[[Study, Path], None], min_success: float = 1.0,
    ) -> None:  # fmt: skip
        """Prepare a search in which every candidate makes all runs of a study.

        Args:
            study: study that is run for each candidate.
            ranges: ranges of the keys to search.
            metric: name of the metric to optimize.
            out: folder of the search.
            carry_out: function that runs a study in a folder.
            min_success: minimum success rate of a candidate.

        Raises:
            StudyError: there is no range, or a key has two ranges or is already varied in the
                study.
        """
        if not ranges:
            raise StudyError("there is no key to search: give --over key=low:high")
        keys = [r.key for r in ranges]
        for key in keys:
            if key in study.keys or keys.count(key) > 1:
                raise StudyError(
                    f"'{key}' is varied twice, by the study and a range or by two ranges: remove "
                    "one of them"
                )
        if study.cases:
            raise StudyError("a study with cases cannot be tuned: move their settings to vary")
        if not 0.0 <= min_success <= 1.0:
            raise StudyError(f"the minimum success rate is {min_success:g}, must be from 0 to 1")
        self._metric: Metric = known_metrics.find_metric(metric)
        needed = (known_metrics.success.name, known_metrics.image_excursion.name, metric)
        self._study = dataclasses.replace(
            study, seeds="repeats", metrics=tuple(dict.fromkeys((*study.metrics, *needed)))
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
        """Search with about `evaluations` candidates, and return the best one.

        Raises:
            StudyError: `evaluations` is too small for two generations of candidates.
        """
        size = max(MIN_CANDIDATES, 4 * len(self._ranges))
        generations = evaluations // size - 1
        if generations < 1:
            raise StudyError(
                f"{evaluations} evaluations are too few: give at least {2 * size}, which are two "
                "generations"
            )
        rng = np.random.default_rng(self._study.seed)
        first = qmc.LatinHypercube(len(self._ranges), rng=rng).random(size)
        # For each candidate, SciPy asks for the violation and for the cost. The second call takes
        # the results from the cache.
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
        """Candidate with the smallest violation; among equal ones, that with the smallest cost."""
        return min(self._cached_candidates.values(), key=lambda c: (c.violation, c.cost))

    def write(self) -> Path:
        """Write candidates.csv and best.yaml (the best settings); return the path of best.yaml."""
        keys = [r.key for r in self._ranges]
        self._out.mkdir(parents=True, exist_ok=True)
        with open(self._out / "candidates.csv", "w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*keys, self._metric.name, "violation", "success", "image_excursion"])
            for c in self.candidates:
                writer.writerow([*c.values, c.cost, c.violation, c.success, c.excursion])
        settings = dict(zip(keys, self.best.values, strict=True))
        (self._out / "best.yaml").write_text(yaml.safe_dump(settings, sort_keys=False))
        return self._out / "best.yaml"

    def _evaluate(self, units: np.ndarray) -> list[Candidate]:
        """Run n candidates, or take their results from the cache.

        units: (n, k) value of each of the k searched keys, as a fraction (0 to 1) of its range.
        """
        rows = np.atleast_2d(units)
        requested = [
            tuple(r.interpolate(u) for r, u in zip(self._ranges, row, strict=True))
            for row in rows.tolist()
        ]
        new = [values for values in dict.fromkeys(requested)
               if values not in self._cached_candidates]  # fmt: skip
        if new:
            self._run(new)
        return [self._cached_candidates[values] for values in requested]

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
            # An unknown excursion counts as infinite, as if the target had left the image.
            worst = float(np.max(np.where(np.isnan(excursion[rows]), np.inf, excursion[rows])))
            self._cached_candidates[values] = Candidate(
                values, sign * float(known.mean()) if known.size else np.inf,
                min(max(worst - 1.0, 0.0), 10.0) + max(self._min_success - rate, 0.0), rate, worst,
            )  # fmt: skip
