"""Tables of results in Markdown, CSV or LaTeX: one row per group of runs with equal settings."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import check_formats
from ..experiment.experiment_keys import find_unit
from ..metrics.formatting import (
    NO_NUMBER,
    choose_unit,
    format_heading,
    format_value,
    make_number_format,
)
from ..metrics.metrics import final_distance, success
from ..metrics.statistics import Estimate, median, quartiles, rate
from . import captions
from .latex import escape_tex, format_tex_interval, format_tex_table
from .results import Results

FORMATS = ("md", "csv", "tex")
RATE, MEDIAN, QUARTILES = "rate", "median", "quartiles"
FAILURE_HEADING = "commonest failure"
MAX_REASON_LENGTH = 90  # maximum number of characters of the reason of a failure
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?")


@dataclass(frozen=True)
class StatisticColumn:
    """Column of a table whose cells are estimates of a statistic of a metric.

    name: name of the metric.
    unit: unit of its values.
    kind: the statistic: RATE, MEDIAN or QUARTILES.
    """

    name: str
    unit: str
    kind: str

    @property
    def heading(self) -> str:
        """Heading of the column, without its unit."""
        return f"{self.name} {QUARTILES}" if self.kind == QUARTILES else self.name

    def estimate(self, values: np.ndarray) -> Estimate:
        """Estimate the column's statistic from the values of some runs."""
        return {RATE: rate, MEDIAN: median, QUARTILES: quartiles}[self.kind](values)


@dataclass(frozen=True)
class Table:
    """Content of a table.

    keys: names of the columns with settings.
    measured: columns with estimates.
    rows: settings, number of runs and estimates of each row.
    failures: most frequent failure of each row; empty: the table has no such column.
    caption: sentences of the caption.
    notes: sentences about missing values and other things that limit the conclusions.
    """

    keys: tuple[str, ...]
    measured: tuple[StatisticColumn, ...]
    rows: tuple[tuple[tuple[object, ...], int, tuple[Estimate, ...]], ...]
    failures: tuple[str, ...] = ()
    caption: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def make_table(
    all_results: Sequence[Results], by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> Table:
    """Make a table with the success rate and estimates of metrics of each group of runs.

    The estimate of a binary metric is its rate with Wilson's interval; of another metric, its
    median with a bootstrap interval; of the final distance, its quartiles, because the success rate
    depends on a tolerance of the distance.

    Args:
        all_results: results of one or more studies.
        by: keys whose values define the groups; empty: all keys of the grid and of the cases.
        metrics: names of the metrics; empty: all metrics.
    """
    first = all_results[0]
    keys = tuple(by) or first.parameters
    many = len(all_results) > 1
    names = (("study",) if many else ()) + keys
    has_distance = all(final_distance.name in r.table.column_names for r in all_results)
    extra_metrics = (final_distance,) if has_distance else ()
    chosen = [m for m in first.select_metrics(metrics) if m not in extra_metrics]
    columns = [
        StatisticColumn(success.name, "", RATE),
        *(StatisticColumn(m.name, m.unit, QUARTILES) for m in extra_metrics),
        *(StatisticColumn(m.name, m.unit, RATE if m.is_binary else MEDIAN) for m in chosen),
    ]
    lines, failures = [], []
    for results in all_results:
        successes = results.compute_successes()
        own_ends, reasons = results.make_end_column().to_pylist(), results.read_column("reason")
        numbers = [successes, *(results.read_values(m) for m in (*extra_metrics, *chosen))]
        for values, rows in results.group_rows(keys).items():
            label = ((results.name,) if many else ()) + values
            own = [column[rows] for column in numbers]
            estimates = (column.estimate(n) for column, n in zip(columns, own, strict=True))
            lines.append((label, len(rows), tuple(estimates)))
            failed = [(own_ends[i], reasons[i]) for i in rows if not successes[i]]
            failures.append(_find_commonest_failure(failed))
    caption = [
        *captions.describe_success(all_results, chosen), captions.RATES,
        *([captions.MEDIANS] if any(column.kind == MEDIAN for column in columns) else []),
        *([captions.QUARTILES] if has_distance else []),
    ]  # fmt: skip
    notes = [
        *captions.describe_missing((*chosen, *extra_metrics), all_results, keys),
        *captions.describe_repeats(all_results),
    ]  # fmt: skip
    return Table(names, tuple(columns), tuple(lines), tuple(failures), tuple(caption),
                 tuple(notes))  # fmt: skip


def _find_commonest_failure(failed: Sequence[tuple[str, str]]) -> str:
    """Describe the most frequent outcome of failed runs and the most frequent reason for it.

    failed: outcome and reason of each failed run."""
    if not failed:
        return ""
    (end, count), = Counter(end for end, _ in failed).most_common(1)
    # Reasons that differ only in their numbers count as one reason; the first of them is printed.
    kinds = Counter(NUMBER.sub("", reason) for outcome, reason in failed if outcome == end)
    (kind, _), = kinds.most_common(1)
    reason = next(r for outcome, r in failed if outcome == end and NUMBER.sub("", r) == kind)
    if len(reason) > MAX_REASON_LENGTH:
        reason = f"{reason[:MAX_REASON_LENGTH].rpartition(' ')[0]} …"
    return f"{count} of {len(failed)} {end}" + (f": {reason}" if reason else "")


def format_table(table: Table, style: str) -> str:
    """Return the table as text.

    style: one of FORMATS.

    Raises:
        StudyError: the style is unknown.
    """
    check_formats([style], FORMATS)
    return {"md": _format_markdown, "csv": _format_csv, "tex": _format_latex}[style](table)


# Function that makes the text of a cell from the texts of a value and of the lower and upper bound
# of its confidence interval; the bounds are None if there is no interval.
IntervalFormat = Callable[[str, str | None, str | None], str]


def _format_cells(table: Table, interval: IntervalFormat, none: str) -> list[list[str]]:
    """Return the headings and the cells of each row.

    All numbers of a column have the same format and the same unit.

    Args:
        table: content of the table.
        interval: function that makes the text of a value with its confidence interval.
        none: text of a missing value.
    """
    headings, formats, sizes = [], [], []
    columns = zip(*(estimates for *_, estimates in table.rows), strict=True)
    for column, estimates in zip(table.measured, columns, strict=True):
        numbers = [number for e in estimates for number in (e.value, e.low, e.high)]
        unit, size = choose_unit(column.unit, numbers)
        headings.append(format_heading(column.heading, unit))
        formats.append(make_number_format([number / size for number in numbers]))
        sizes.append(size)
    keys = [format_heading(key, find_unit(key)) for key in table.keys]
    lines = [[*keys, "runs", *headings]]
    for values, count, estimates in table.rows:
        cells = []
        for text, size, e in zip(formats, sizes, estimates, strict=True):
            if not e.count or np.isnan(e.value):
                cells.append(none)
            elif np.isnan(e.low):
                cells.append(interval(text(e.value / size), None, None))
            else:
                cells.append(interval(*(text(n / size) for n in (e.value, e.low, e.high))))
        lines.append([*map(format_value, values), str(count), *cells])
    return lines


def _format_markdown(table: Table) -> str:
    lines = _format_cells(table, _format_interval, NO_NUMBER)
    if table.failures:
        failures = [FAILURE_HEADING, *(one or NO_NUMBER for one in table.failures)]
        lines = [[*line, failure] for line, failure in zip(lines, failures, strict=True)]
    lines = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    lines.insert(1, ["---"] * len(lines[0]))
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return "\n\n".join([text, *table.caption, *table.notes]) + "\n"


def _format_interval(value: str, low: str | None, high: str | None) -> str:
    return value if low is None else f"{value} [{low}, {high}]"


def _format_csv(table: Table) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    parts = ("", "_low", "_high", "_n")
    columns = [
        column.heading.replace(" ", "_") + part for column in table.measured for part in parts
    ]
    heading = [*table.keys, "runs", *columns]
    writer.writerow([*heading, *([FAILURE_HEADING] if table.failures else [])])
    for row, (values, count, estimates) in enumerate(table.rows):
        numbers = [n for e in estimates for n in (e.value, e.low, e.high, e.count)]
        writer.writerow([*values, count, *numbers, *table.failures[row : row + 1]])
    return out.getvalue()


def _format_latex(table: Table) -> str:
    """Format a table as LaTeX table environments, without the column of failures (too wide)."""
    heading, *body = _format_cells(table, format_tex_interval, "--")
    settings = len(table.keys)
    body = [[*map(escape_tex, row[:settings]), *row[settings:]] for row in body]
    return format_tex_table(heading, body, settings + 1, table.caption, table.notes)
