"""Summary of a run: numbers with units and definitions; and comparison of several runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..recording.run import Run
from . import metrics
from .formatting import NO_NUMBER, choose_unit, make_number_format
from .metric import SMALLER

COUNT_METRICS = ("iterations", "images", "images_late")
# length of the interval at the end of a run over which the mean error is computed, s
FINAL_WINDOW = 1.0
# Length of the interval at the end of a run over which the largest error is determined, s.
LAST = 2.0
DIGITS = 4  # number of significant digits of the numbers in a summary


@dataclass(frozen=True)
class Quantity:
    """One quantity of a summary.

    key: name of the quantity.
    value: number or text; NaN if unknown.
    unit: unit of the value; '' if it has none.
    text: definition of the quantity.
    better: 'smaller', 'greater', or '' if neither is better.
    is_feature_based: True if the value depends on the features of the scheme, so that it cannot be
        compared between schemes.
    is_binary: True if the value is 1 for yes and 0 for no.
    """

    key: str
    value: float | int | str
    unit: str
    text: str
    better: str = ""
    is_feature_based: bool = False
    is_binary: bool = False

    @property
    def value_text(self) -> str:
        """Value as text, in `shown_unit`; '–' if it is unknown."""
        return show_quantities([self])[0][0]

    @property
    def shown_unit(self) -> str:
        """Unit that suits the magnitude of the value."""
        return show_quantities([self])[1]


def show_quantities(quantities: Sequence[Quantity | None]) -> tuple[list[str], str]:
    """Return the values of a quantity in several runs as texts, and the unit of the texts.

    The unit suits the magnitude of the values: see `choose_unit`.
    """
    known = [q for q in quantities if q is not None]
    numbers = [q.value for q in known if isinstance(q.value, float)]
    unit, size = choose_unit(known[0].unit, numbers)
    scaled = [replace(q, value=q.value / size) if q is not None and isinstance(q.value, float)
              else q for q in quantities]  # fmt: skip
    return format_quantities(scaled), unit


def format_quantities(quantities: Sequence[Quantity | None]) -> list[str]:
    """Format the values of quantities that are printed side by side; unknown values are '–'."""
    numbers = [q.value for q in quantities if q is not None and isinstance(q.value, float)]
    format_number = make_number_format(numbers, DIGITS)
    texts = []
    for q in quantities:
        if q is None or q.value == "":
            texts.append(NO_NUMBER)
        elif q.is_binary and q.value in (0, 1):
            texts.append("yes" if q.value else "no")
        else:
            texts.append(format_number(q.value) if isinstance(q.value, float) else str(q.value))
    return texts


def summarise(run: Run) -> list[Quantity]:
    """Return the outcome, the true result, the metrics and the final errors of a run."""
    found = [
        Quantity("outcome", run.outcome, "", "result of the run according to the servo loop"),
        Quantity(
            "verdict", run.verdict.name, "", "result of the run according to the camera's true pose"
        ),
        Quantity("reason", run.reason, "", "explanation of the servo loop"),
        Quantity("remedy", run.remedy, "", "suggested change"),
    ]
    for name, metric in metrics.METRICS.items():
        value = float(metric.measure(run))
        if name in COUNT_METRICS:
            value = int(value)
        found.append(Quantity(
            name, value, metric.unit, metric.text, metric.better, metric.is_feature_based,
            metric.is_binary,
        ))
    return [*found, *_summarize_features(run)]


def _summarize_features(run: Run) -> list[Quantity]:
    """Return the mean and the largest error of each feature at the end of the run."""
    known = np.isfinite(run.error).all(axis=1)
    stamp, error = run.stamp[known], run.error[known]
    found = []
    for i, name in enumerate(run.names if len(stamp) else ()):
        late, last = (error[stamp >= stamp[-1] - window, i] for window in (FINAL_WINDOW, LAST))
        found += [
            Quantity(f"final_error_{name}", float(late.mean()), run.units[i],
                     f"mean error of {name} over the last {FINAL_WINDOW:g} s"),
            Quantity(f"worst_error_{name}", float(np.abs(last).max()), run.units[i],
                     f"largest error of {name} in the last {LAST:g} s"),
        ]  # fmt: skip
    return found


def make_mapping(run: Run, quantities: Sequence[Quantity]) -> dict[str, object]:
    """Return the content of summary.json; an unknown number is null."""
    plain = {
        q.key: None if isinstance(q.value, float) and not math.isfinite(q.value) else q.value
        for q in quantities
    }
    return {
        "name": run.name,
        "source": run.source,
        **plain,
        "converged": run.is_held_at_goal,
        "settings": dict(run.settings),
        "versions": dict(run.versions),
        "notes": list(run.notes),
        "units": {q.key: q.unit for q in quantities if q.unit},
        "definitions": {q.key: q.text for q in quantities},
    }


def describe_run(run: Run, quantities: Sequence[Quantity]) -> str:
    """Return the summary of a run as text for a terminal."""
    known = {q.key: q for q in quantities}

    def format_number(key: str, text: str, factor: float = 1.0, none: str = "unknown") -> str:
        value = float(known[key].value)
        return text.format(factor * value) if math.isfinite(value) else none

    reason = str(known["reason"].value)
    outcome = str(known["outcome"].value) + (f" ({reason})" if reason else "")
    remark = reason if run.converged else f"yet {outcome}"
    verdict = "yes, and held" + (f"; {remark}" if remark else "")
    rows = [("Target reached", verdict if run.is_held_at_goal else f"NO: {outcome}")]
    if known["remedy"].value:
        rows.append(("Remedy", str(known["remedy"].value)))
    where_known = math.isfinite(known["final_distance"].value)
    rows += [
        ("Error under 2 % after", format_number("error_settled", "{:.2f} s", none="never")),
        ("Camera within 2 % after", format_number(
            "settled", "{:.2f} s", none="never" if where_known else "unknown")),
        ("Camera off its goal by", format_number("final_distance", "{:.2f} mm, ", 1e3)
         + format_number("final_angle", "{:.2f} degrees", 180.0 / math.pi, "")),
        *((f"Error of {q.key.removeprefix('final_error_')}",
           f"{1e3 * q.value:+z.2f} mm" if q.unit == "m" else
           f"{math.degrees(q.value):+z.2f} degrees" if q.unit == "rad" else
           f"{q.value:+z.2g} {q.unit}".strip())
          for q in [q for q in quantities if q.key.startswith("final_error_")][:8]
          if math.isfinite(q.value)),
        *([("Simulation speed", format_number("real_time_factor", "{:.2f} x real time"))]
          if math.isfinite(known["real_time_factor"].value) else []),
        ("Camera images", f"{known['images'].value}" + (
            format_number("image_rate", " at {:.1f} Hz, ") + f"{known['images_late'].value} late"
            if known["images"].value else "")),
    ]  # fmt: skip
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name:<{width}}  {value}" for name, value in rows)


def find_best_runs(
    runs: Sequence[Run], columns: Sequence[Sequence[Quantity]], key: str
) -> set[int]:
    """Return the indices of the successful runs with the best value of a quantity.

    Values that are printed with the same digits count as equal. The result is empty if no run
    succeeded, if all values are equal, or if the quantity depends on features that differ between
    the runs.
    """
    quantities = [{q.key: q for q in column}.get(key) for column in columns]
    comparable = {i: q for i, q in enumerate(quantities)
            if runs[i].is_success and q is not None and q.better
            and isinstance(q.value, (int, float)) and math.isfinite(q.value)}  # fmt: skip
    schemes = {(runs[i].scheme, runs[i].names) for i in comparable}
    if not comparable or len(schemes) > 1 and any(q.is_feature_based for q in comparable.values()):
        return set()
    printed = dict(zip(comparable, format_quantities(list(comparable.values())), strict=True))
    if len(set(printed.values())) < 2:
        return set()
    smaller = next(iter(comparable.values())).better == SMALLER
    best = (min if smaller else max)(comparable, key=lambda i: comparable[i].value)
    return {i for i in comparable if printed[i] == printed[best]}
