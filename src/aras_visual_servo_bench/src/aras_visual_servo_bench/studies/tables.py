"""Tables of results in Markdown, CSV or LaTeX: one row per setting, with confidence intervals."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import check_formats
from ..experiment.experiment_keys import find_unit
from ..metrics.formatting import NO_NUMBER, format_heading, format_value, make_number_format
from ..metrics.statistics import Estimate, median, proportion
from .results import Results

FORMATS = ("md", "csv", "tex")
FAILURE_HEADING = "commonest failure"
MAX_REASON_LENGTH = 90  # maximum number of characters of a reason in a cell
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?")


@dataclass(frozen=True)
class Table:
    """Content of a table.

    keys: names of the columns with settings.
    measured: name and unit of each column with estimates.
    rows: settings and estimates of each row.
    failures: most frequent failure of each row; empty: the table has no such column.
    """

    keys: tuple[str, ...]
    measured: tuple[tuple[str, str], ...]
    rows: tuple[tuple[tuple[object, ...], tuple[Estimate, ...]], ...]
    failures: tuple[str, ...] = ()


def make_table(
    all_results: Sequence[Results], by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> Table:
    """Make a table with the success rate and the medians of metrics of each group of runs.

    Success rates have Wilson's confidence interval, medians have a bootstrap interval.

    Args:
        all_results: results of one or more studies.
        by: keys whose values define the groups; empty: all keys of the grid and of the cases.
        metrics: names of the metrics; empty: all metrics.
    """
    first = all_results[0]
    keys = tuple(by) or first.parameters
    chosen = first.select_metrics(metrics)
    many = len(all_results) > 1
    lines, failures = [], []
    for results in all_results:
        success, ends, reasons = (
            results.compute_successes(),
            results.describe_ends(),
            results.read_column("reason"),
        )
        numbers = [results.read_numbers(m.name) for m in chosen]
        for values, rows in results.group_rows(keys).items():
            rate = proportion(int(success[rows].sum()), len(rows))
            others = tuple(median(n[rows]) for n in numbers)
            lines.append((((results.name,) if many else ()) + values, (rate, *others)))
            failures.append(
                _find_commonest_failure([(ends[i], reasons[i]) for i in rows if not success[i]])
            )
    names = (("study",) if many else ()) + keys
    measured = (("success", ""), *((m.name, m.unit) for m in chosen))
    return Table(names, measured, tuple(lines), tuple(failures))


def _find_commonest_failure(failed: Sequence[tuple[str, str]]) -> str:
    """Describe the most frequent outcome of failed runs and the most frequent reason for it.

    failed: outcome and reason of each failed run."""
    if not failed:
        return ""
    (end, count), = Counter(end for end, _ in failed).most_common(1)
    # Reasons that differ only in numbers are treated as the same reason; the first one is printed.
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


def _make_headings(table: Table) -> list[str]:
    keys = [format_heading(key, find_unit(key)) for key in table.keys]
    measured = [format_heading(*m) for m in table.measured]
    return [*keys, "runs", *measured, *([FAILURE_HEADING] if table.failures else [])]


# Function that combines the texts of a value, its lower bound and its upper bound into a cell.
IntervalFormat = Callable[[str, str, str], str]


def _format_cells(table: Table, interval: IntervalFormat, none: str) -> Iterator[list[str]]:
    """Yield the cells of each row; all numbers of a column have the same format.

    Args:
        table: content of the table.
        interval: function that formats a value with its confidence interval.
        none: text of a missing value.
    """
    columns = zip(*(estimates for _, estimates in table.rows), strict=True)
    formats = [make_number_format([n for e in column for n in (e.value, e.low, e.high)])
               for column in columns]  # fmt: skip
    for row, (values, estimates) in enumerate(table.rows):
        known = [e.count and not np.isnan(e.value) for e in estimates]
        yield [
            *map(format_value, values), str(estimates[0].count),
            *(interval(*map(text, (e.value, e.low, e.high))) if is_known else none
              for text, e, is_known in zip(formats, estimates, known, strict=True)),
            *([table.failures[row] or none] if table.failures else []),
        ]  # fmt: skip


def _format_markdown(table: Table) -> str:
    heading = _make_headings(table)
    lines = [heading, ["---"] * len(heading)]
    for cells in _format_cells(
        table, lambda value, low, high: f"{value} [{low}, {high}]", NO_NUMBER
    ):
        lines.append([cell.replace("|", "\\|") for cell in cells])
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{text}\n\nRates with Wilson's 95 % interval, medians with a bootstrap 95 % interval.\n"


def _format_csv(table: Table) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    parts = ("", "_low", "_high", "_n")
    columns = [name + part for name, _ in table.measured for part in parts]
    writer.writerow([*table.keys, *columns, *([FAILURE_HEADING] if table.failures else [])])
    for row, (values, estimates) in enumerate(table.rows):
        numbers = [n for e in estimates for n in (e.value, e.low, e.high, e.count)]
        writer.writerow([*values, *numbers, *table.failures[row : row + 1]])
    return out.getvalue()


_TEX_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "²": r"$^2$",
}  # fmt: skip


def _escape_tex(text: str) -> str:
    return "".join(_TEX_ESCAPES.get(c, c) for c in text)


def _format_power(number: str) -> str:
    """Write a number such as 1e-04 as a power of ten for a LaTeX formula."""
    digits, e, exponent = number.partition("e")
    return f"{digits} \\cdot 10^{{{int(exponent)}}}" if e else number


def _format_latex(table: Table) -> str:
    """Format a table for the LaTeX package booktabs."""
    heading, text_columns = _make_headings(table), "l" if table.failures else ""
    numbers = len(heading) - len(table.keys) - len(text_columns)
    lines = [
        r"\begin{tabular}{" + "l" * len(table.keys) + "r" * numbers + text_columns + "}",
        r"\toprule", " & ".join(map(_escape_tex, heading)) + r" \\", r"\midrule",
    ]  # fmt: skip
    for cells in _format_cells(table, _format_tex_interval, "--"):
        for i in (*range(len(table.keys)), *range(len(table.keys) + numbers, len(heading))):
            cells[i] = _escape_tex(cells[i])
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _format_tex_interval(value: str, low: str, high: str) -> str:
    return f"${_format_power(value)}$ {{\\small $[{_format_power(low)}, {_format_power(high)}]$}}"
