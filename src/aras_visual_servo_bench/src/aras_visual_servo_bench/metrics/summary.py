"""A run in numbers, each with its unit and what it means; and several runs beside each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..recording.run import Run
from . import metrics
from .formatting import NO_NUMBER, make_number_format

COUNT_METRICS = ("iterations", "images", "images_late")
FINAL_WINDOW, LAST = 1.0, 2.0  # s before the end
DIGITS = 4  # that a report prints


@dataclass(frozen=True)
class Quantity:
    """One number or word of a summary.

    key: its name. value: a float (NaN: there is none), a word, or an int. unit: '' for none.
    text: what it is. better: 'smaller', 'greater', or '' where neither is.
    of_features: measured on the scheme's own features, which other schemes have not.
    """

    key: str
    value: float | int | str
    unit: str
    text: str
    better: str = ""
    is_feature_based: bool = False

    @property
    def value_text(self) -> str:
        """As it is printed; '–' for what there is none of."""
        return format_quantities([self])[0]


def format_quantities(quantities: Sequence[Quantity | None]) -> list[str]:
    """As they are printed beside each other; '–' for what there is none of."""
    numbers = [q.value for q in quantities if q is not None and isinstance(q.value, float)]
    printed = make_number_format(numbers, DIGITS)
    return [
        NO_NUMBER if q is None or q.value == "" else
        printed(q.value) if isinstance(q.value, float) else str(q.value)
        for q in quantities
    ]  # fmt: skip


def summarise(run: Run) -> list[Quantity]:
    """All that is known of a run in numbers."""
    found = [
        Quantity("outcome", run.outcome, "", "what the loop knows of the run's end"),
        Quantity("verdict", run.verdict.name, "", "what the true pose of the camera says of it"),
        Quantity("reason", run.reason, "", "why, as the loop tells it"),
        Quantity("remedy", run.remedy, "", "what to change"),
    ]
    for name, metric in metrics.METRICS.items():
        value = float(metric.measure(run))
        if name in COUNT_METRICS:
            value = int(value)
        found.append(Quantity(
            name, value, metric.unit, metric.text, metric.better, metric.is_feature_based
        ))
    return [*found, *_summarize_features(run)]


def _summarize_features(run: Run) -> list[Quantity]:
    """Errors of each feature at the end."""
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
    """The contents of summary.json; what there is no number of is null."""
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
    """The summary in words a person understands."""
    known = {q.key: q for q in quantities}

    def format_number(key: str, text: str, factor: float = 1.0, none: str = "unknown") -> str:
        value = float(known[key].value)
        return text.format(factor * value) if math.isfinite(value) else none

    reason = str(known["reason"].value)
    said = str(known["outcome"].value) + (f" ({reason})" if reason else "")
    doubt = reason if run.converged else f"yet {said}"
    reached = "yes, and held" + (f"; {doubt}" if doubt else "")
    rows = [("Target reached", reached if run.is_held_at_goal else f"NO: {said}")]
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
    """Which of the runs that succeeded are best in this quantity, to the printed digits.

    Empty where less than two can be compared: by their number of successes, or because the
    quantity is of features that not all of them have.
    """
    found = [{q.key: q for q in column}.get(key) for column in columns]
    able = {i: q for i, q in enumerate(found)
            if runs[i].is_success and q is not None and q.better
            and isinstance(q.value, (int, float)) and math.isfinite(q.value)}  # fmt: skip
    schemes = {(runs[i].scheme, runs[i].names) for i in able}
    if not able or len(schemes) > 1 and any(q.is_feature_based for q in able.values()):
        return set()
    printed = dict(zip(able, format_quantities(list(able.values())), strict=True))
    if len(set(printed.values())) < 2:
        return set()
    smaller = next(iter(able.values())).better == metrics.SMALLER
    top = (min if smaller else max)(able, key=lambda i: able[i].value)
    return {i for i in able if printed[i] == printed[top]}
