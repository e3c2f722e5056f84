"""Tables of results: a row for each setting, with intervals; Markdown, CSV or LaTeX."""

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
MAX_REASON_LENGTH = 90  # letters of a reason in a cell
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?")


@dataclass(frozen=True)
class Table:
    """Cells.

    keys: names of the leading columns. measured: of the estimates, with their units.
    failures: of each row, why runs did not succeed; empty: the table has no such column.
    """

    keys: tuple[str, ...]
    measured: tuple[tuple[str, str], ...]
    rows: tuple[tuple[tuple[object, ...], tuple[Estimate, ...]], ...]
    failures: tuple[str, ...] = ()


def make_table(
    all_results: Sequence[Results], by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> Table:
    """Success with Wilson's interval, and medians with the bootstrap's, of each group of rows.

    Args:
        by: keys that make the groups; empty: the grid's and the cases'.
        metrics: names; empty: all.
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
    """The end and reason that most of the failed runs have, with how many of them end so."""
    if not failed:
        return ""
    (end, count), = Counter(end for end, _ in failed).most_common(1)
    # Reasons that differ by their numbers are one reason, told of the first such run.
    kinds = Counter(NUMBER.sub("", why) for of, why in failed if of == end)
    (kind, _), = kinds.most_common(1)
    reason = next(why for of, why in failed if of == end and NUMBER.sub("", why) == kind)
    if len(reason) > MAX_REASON_LENGTH:
        reason = f"{reason[:MAX_REASON_LENGTH].rpartition(' ')[0]} …"
    return f"{count} of {len(failed)} {end}" + (f": {reason}" if reason else "")


def format_table(table: Table, style: str) -> str:
    """The table as text; StudyError for a style that there is not."""
    check_formats([style], FORMATS)
    return {"md": _format_markdown, "csv": _format_csv, "tex": _format_latex}[style](table)


def _make_headings(table: Table) -> list[str]:
    keys = [format_heading(key, find_unit(key)) for key in table.keys]
    measured = [format_heading(*m) for m in table.measured]
    return [*keys, "runs", *measured, *([FAILURE_HEADING] if table.failures else [])]


IntervalFormat = Callable[[str, str, str], str]  # of value, low and high as they are printed


def _format_cells(table: Table, interval: IntervalFormat, none: str) -> Iterator[list[str]]:
    """Words of each row; numbers of a column are all printed with powers of ten, or none is."""
    columns = zip(*(estimates for _, estimates in table.rows), strict=True)
    printed = [make_number_format([n for e in column for n in (e.value, e.low, e.high)])
               for column in columns]  # fmt: skip
    for row, (values, estimates) in enumerate(table.rows):
        known = [e.count and not np.isnan(e.value) for e in estimates]
        yield [
            *map(format_value, values), str(estimates[0].count),
            *(interval(*map(p, (e.value, e.low, e.high))) if there else none
              for p, e, there in zip(printed, estimates, known, strict=True)),
            *([table.failures[row] or none] if table.failures else []),
        ]  # fmt: skip


def _format_markdown(table: Table) -> str:
    heading = _make_headings(table)
    lines = [heading, ["---"] * len(heading)]
    for cells in _format_cells(
        table, lambda value, low, high: f"{value} [{low}, {high}]", NO_NUMBER
    ):
        lines.append([cell.replace("|", "\\|") for cell in cells])
    told = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{told}\n\nRates with Wilson's 95 % interval, medians with the bootstrap's.\n"


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
    """A number in a formula, where 1e-04 would be read as a product with e."""
    digits, e, exponent = number.partition("e")
    return f"{digits} \\cdot 10^{{{int(exponent)}}}" if e else number


def _format_latex(table: Table) -> str:
    """For the package booktabs."""
    heading, told = _make_headings(table), "l" if table.failures else ""
    numbers = len(heading) - len(table.keys) - len(told)
    lines = [
        r"\begin{tabular}{" + "l" * len(table.keys) + "r" * numbers + told + "}",
        r"\toprule", " & ".join(map(_escape_tex, heading)) + r" \\", r"\midrule",
    ]  # fmt: skip
    for cells in _format_cells(table, _format_tex_interval, "--"):
        for i in (*range(len(table.keys)), *range(len(table.keys) + numbers, len(heading))):
            cells[i] = _escape_tex(cells[i])
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _format_tex_interval(value: str, low: str, high: str) -> str:
    return f"${_format_power(value)}$ {{\\small $[{_format_power(low)}, {_format_power(high)}]$}}"
