"""A run in numbers, each with its unit and what it means; and several runs beside each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..recording.record import Images, Record, scaled
from ..report.machine import condition
from . import metrics

SETTLED = 0.02  # part of the first error
LATE = 1.5  # image periods
FINAL_WINDOW, LAST = 1.0, 2.0  # s before the end
DIGITS = 4  # that are printed


@dataclass(frozen=True)
class Quantity:
    """One number or word of a summary.

    key: its name. value: a float (NaN: there is none), a word, or an int. unit: '' for none.
    text: what it is. better: 'smaller', 'greater', or '' where neither is.
    """

    key: str
    value: float | int | str
    unit: str
    text: str
    better: str = ""

    @property
    def shown(self) -> str:
        """As it is printed; '–' for what there is none of."""
        if isinstance(self.value, float):
            return printed(self.value)
        return str(self.value) if self.value != "" else "–"


def printed(value: float) -> str:
    """A number to the digits that all tables of a report have."""
    return f"{value:.{DIGITS}g}" if math.isfinite(value) else "–"


def settling_time(stamp: np.ndarray, size: np.ndarray, part: float = SETTLED) -> float:
    """From stamp[0] until size (n,) stays under a part of its first value, s; NaN: never."""
    above = np.flatnonzero(size > part * size[0])
    if not above.size:
        return 0.0
    after = int(above[-1]) + 1
    return float(stamp[after] - stamp[0]) if after < len(stamp) else float("nan")


def summarise(record: Record) -> list[Quantity]:
    """All that is known of a run in numbers."""
    run = record.run
    found = [
        Quantity("outcome", run.outcome, "", "what the loop knows of the run's end"),
        Quantity("verdict", run.verdict.word, "", "what the true pose of the camera says of it"),
        Quantity("reason", run.reason, "", "why, as the loop tells it"),
        Quantity("mend", run.mend, "", "what would mend it"),
    ]
    for name, metric in metrics.BUILT_IN.items():
        value = _measured(metric, record)
        found.append(Quantity(name, value, metric.unit, metric.text, metric.better))
    return [*found, *_of_errors(record), *_of_loop(record), *_of_time(record)]


def _measured(metric: metrics.Metric, record: Record) -> float:
    """A metric of the studies; NaN where the record lacks what it is made of."""
    if not len(record.run.joint_stamp) or not record.servoing.any():
        return float("nan")
    return float(metric.measure(record))


def _of_errors(record: Record) -> list[Quantity]:
    run = record.run
    known = np.isfinite(run.error).all(axis=1) if run.error.size else np.zeros(0, bool)
    stamp, error = run.stamp[known], run.error[known]
    settled = float("nan")
    if len(stamp):
        settled = settling_time(stamp, np.linalg.norm(scaled(error), axis=1))
    found = [Quantity(
        "error_settled", settled, "s",
        "time until the norm of the features' errors, each in parts of its largest, stays under "
        "2 % of its first", metrics.SMALLER,
    )]  # fmt: skip
    for i, name in enumerate(run.names):
        late = stamp >= stamp[-1] - FINAL_WINDOW if len(stamp) else known
        last = stamp >= stamp[-1] - LAST if len(stamp) else known
        mean = float(error[late, i].mean()) if len(stamp) else float("nan")
        worst = float(np.abs(error[last, i]).max()) if len(stamp) else float("nan")
        found += [
            Quantity(f"final_error_{name}", mean, record.units[i],
                     f"mean error of {name} over the last {FINAL_WINDOW:g} s"),
            Quantity(f"worst_error_{name}", worst, record.units[i],
                     f"largest error of {name} in the last {LAST:g} s"),
        ]  # fmt: skip
    return found


def _of_loop(record: Record) -> list[Quantity]:
    run, details = record.run, record.details
    speed = np.linalg.norm(run.achieved[:, :3], axis=1) if len(run.stamp) else np.zeros(0)
    return [
        Quantity("servoing_time", float(np.ptp(run.stamp)) if len(run.stamp) else 0.0, "s",
                 "from the first image that was answered to the last"),
        Quantity("top_speed", float(np.nanmax(speed, initial=0.0)), "m/s",
                 "greatest speed of the camera that the joints were given"),
        Quantity("smallest_singular_value", _least(details.singular_LJ), "",
                 "least singular value of the task's Jacobian L J", metrics.GREATER),
        Quantity("condition_L", _greatest(condition(details.singular_L)), "",
                 "greatest condition number of L in the directions that are servoed",
                 metrics.SMALLER),
        Quantity("manipulability", _least(details.manipulability), "",
                 "least product of the singular values of L J", metrics.GREATER),
        Quantity("scale", _least(details.scale), "",
                 "least factor by which limits slowed the task; 1: never", metrics.GREATER),
    ]  # fmt: skip


def _of_time(record: Record) -> list[Quantity]:
    figures = image_figures(record.images)
    delay = 1e3 * (record.images.arrival - record.images.stamp)
    return [
        Quantity("images", len(record.images.stamp), "", "images that were recorded"),
        Quantity("image_rate", figures["rate"], "Hz", "images a second of simulated time"),
        Quantity("images_late", figures["late"], "", "images that are missing, or came more than "
                 f"{LATE:g} periods after their exposure", metrics.SMALLER),
        Quantity("delay", float(delay.mean()) if delay.size else float("nan"), "ms",
                 "mean time from an exposure until the recorder had it"),
        Quantity("computing", 1e3 * _mean(record.details.computing), "ms",
                 "mean time that the scheme took for an image"),
        Quantity("real_time_factor", record.real_time_factor, "",
                 "simulated over wall time while servoing"),
    ]  # fmt: skip


def image_figures(images: Images) -> dict[str, float | int]:
    """rate, Hz of simulated time (NaN: unknown), and how many are late.

    Late is an image that the recorder had more than 1.5 periods after its exposure; a gap of
    n periods between two exposures counts as n - 1 late images.
    """
    gaps = np.diff(images.stamp)
    if not gaps.size:
        return {"rate": float("nan"), "late": 0}
    period = float(np.median(gaps))
    missing = np.maximum(np.round(gaps / period) - 1.0, 0.0).sum()
    late = np.count_nonzero(images.arrival - images.stamp > LATE * period)
    rate = float(gaps.size / (images.stamp[-1] - images.stamp[0]))
    return {"rate": rate, "late": int(missing) + int(late)}


def _least(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if known.size else float("nan")


def _greatest(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return float(known.max()) if known.size else float("nan")


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def mapping(record: Record, quantities: Sequence[Quantity]) -> dict[str, object]:
    """The contents of summary.json; what there is no number of is null."""
    plain = {
        q.key: None if isinstance(q.value, float) and not math.isfinite(q.value) else q.value
        for q in quantities
    }
    return {
        "name": record.name,
        "source": record.source,
        **plain,
        "converged": record.converged,
        "settings": dict(record.settings),
        "versions": dict(record.versions),
        "notes": list(record.notes),
        "units": {q.key: q.unit for q in quantities if q.unit},
        "definitions": {q.key: q.text for q in quantities},
    }


def told(record: Record, quantities: Sequence[Quantity]) -> str:
    """The summary in words a person understands."""
    known = {q.key: q for q in quantities}

    def number(key: str, text: str, factor: float = 1.0, none: str = "unknown") -> str:
        value = float(known[key].value)
        return text.format(factor * value) if math.isfinite(value) else none

    reason = str(known["reason"].value)
    said = str(known["outcome"].value) + (f" ({reason})" if reason else "")
    doubt = reason if record.run.converged else f"yet {said}"
    reached = "yes, and held" + (f"; {doubt}" if doubt else "")
    rows = [("Target reached", reached if record.converged else f"NO: {said}")]
    if known["mend"].value:
        rows.append(("What would mend it", str(known["mend"].value)))
    where_known = math.isfinite(known["final_distance"].value)
    rows += [
        ("Error under 2 % after", number("error_settled", "{:.2f} s", none="never")),
        ("Camera within 2 % after", number(
            "settled", "{:.2f} s", none="never" if where_known else "unknown")),
        ("Camera off its goal by", number("final_distance", "{:.2f} mm, ", 1e3)
         + number("final_angle", "{:.2f} degrees", 180.0 / math.pi, "")),
        *((f"Error of {q.key.removeprefix('final_error_')}",
           f"{1e3 * q.value:+.2f} mm" if q.unit == "m" else
           f"{math.degrees(q.value):+.2f} degrees" if q.unit == "rad" else
           f"{q.value:+.2g} {q.unit}".strip())
          for q in [q for q in quantities if q.key.startswith("final_error_")][:8]
          if math.isfinite(q.value)),
        ("Simulation speed", number("real_time_factor", "{:.2f} x real time")),
        ("Camera images", f"{known['images'].value}" + (
            number("image_rate", " at {:.1f} Hz, ") + f"{known['images_late'].value} late"
            if known["images"].value else "")),
    ]  # fmt: skip
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name:<{width}}  {value}" for name, value in rows)


def best(columns: Mapping[str, Sequence[Quantity]], key: str) -> set[str]:
    """Names of the runs that are best in this quantity; empty where nothing is better."""
    values = {name: {q.key: q for q in qs}.get(key) for name, qs in columns.items()}
    known = {name: float(q.value) for name, q in values.items()
             if q is not None and q.better and isinstance(q.value, (int, float))
             and math.isfinite(q.value)}  # fmt: skip
    if len(known) < 2 or len({printed(v) for v in known.values()}) < 2:
        return set()
    smaller = next(q for q in values.values() if q is not None).better == metrics.SMALLER
    top = min(known.values()) if smaller else max(known.values())
    return {name for name, value in known.items() if printed(value) == printed(top)}
