"""Tables of results in Markdown, CSV or LaTeX: one row per setting, with confidence intervals."""

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
from ..metrics.metrics import Metric, final_distance, success
from ..metrics.statistics import Estimate, median, quartiles, rate
from . import captions
from .results import Results

FORMATS = ("md", "csv", "tex")
RATE, MEDIAN, QUARTILES = "rate", "median", "quartiles"  # kinds of columns
# Letters of `\\small` in the 12 cm of a page of LaTeX's class `article`, and between two columns.
MAX_TEX_WIDTH, TEX_GAP = 82, 3
MAX_TEX_LINES = 40  # of a float; further tabulars are in another one
FAILURE_HEADING = "commonest failure"
MAX_REASON_LENGTH = 90  # characters of a reason in a cell
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?")


@dataclass(frozen=True)
class Column:
    """A column with estimates.

    name: of the metric. unit: of its values. kind: RATE, MEDIAN or QUARTILES.
    """

    name: str
    unit: str
    kind: str

    @property
    def heading(self) -> str:
        """Name of the column."""
        return f"{self.name} {QUARTILES}" if self.kind == QUARTILES else self.name

    def estimate(self, values: np.ndarray) -> Estimate:
        """Estimate the column's statistic from the values of some runs."""
        return {RATE: rate, MEDIAN: median, QUARTILES: quartiles}[self.kind](values)


@dataclass(frozen=True)
class Table:
    """Content of a table.

    keys: names of the columns with settings. measured: columns with estimates. rows: settings,
    number of runs and estimates of each row. failures: most frequent failure of each row; empty: no
    such column. caption: sentences.
    """

    keys: tuple[str, ...]
    measured: tuple[Column, ...]
    rows: tuple[tuple[tuple[object, ...], int, tuple[Estimate, ...]], ...]
    failures: tuple[str, ...] = ()
    caption: tuple[str, ...] = ()


def make_table(
    all_results: Sequence[Results], by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> Table:
    """Make the table of success, and of the metrics, of each group of runs.

    Binary metrics are summarised by their rate with Wilson's interval, other metrics by their
    median with a bootstrap interval. The quartiles of the final distance follow success, which
    depends on a tolerance.

    Args:
        by: keys that define the groups; empty: those of the grid and the cases.
        metrics: names; empty: all.
    """
    first = all_results[0]
    keys = tuple(by) or first.parameters
    chosen = first.select_metrics(metrics)
    many = len(all_results) > 1
    names = (("study",) if many else ()) + keys
    has_distance = all(final_distance.name in r.table.column_names for r in all_results)
    beside = (final_distance,) if has_distance else ()
    columns = [
        Column(success.name, "", RATE),
        *(Column(m.name, m.unit, QUARTILES) for m in beside),
        *(Column(m.name, m.unit, RATE if m.is_binary else MEDIAN) for m in chosen),
    ]
    lines, failures, ends = [], [], []
    grouped: dict[Metric, list[tuple[str, np.ndarray]]] = {m: [] for m in (*chosen, *beside)}
    for results in all_results:
        successes, own_ends, reasons = (
            results.compute_successes(),
            results.describe_ends(),
            results.read_column("reason"),
        )
        numbers = [successes, *(results.read_values(m) for m in (*beside, *chosen))]
        for values, rows in results.group_rows(keys).items():
            label = ((results.name,) if many else ()) + values
            own = [column[rows] for column in numbers]
            estimates = (column.estimate(n) for column, n in zip(columns, own, strict=True))
            lines.append((label, len(rows), tuple(estimates)))
            failed = [(own_ends[i], reasons[i]) for i in rows if not successes[i]]
            failures.append(_find_commonest_failure(failed))
            ends += [own_ends[i] for i in rows]
            group = captions.name_group(names, label)
            grouped |= {m: [*grouped[m], (group, n)]
                        for m, n in zip((*beside, *chosen), own[1:], strict=True)}  # fmt: skip
    caption = [
        *captions.describe_success(all_results, chosen), captions.RATES,
        *([captions.MEDIANS] if any(column.kind == MEDIAN for column in columns) else []),
        *([captions.QUARTILES] if has_distance else []),
        *(line for m, groups in grouped.items()
          for line in captions.describe_missing(m, groups, ends)),
        *captions.describe_repeats(all_results),
    ]  # fmt: skip
    return Table(names, tuple(columns), tuple(lines), tuple(failures), tuple(caption))


def _find_commonest_failure(failed: Sequence[tuple[str, str]]) -> str:
    """Describe the most frequent outcome of failed runs with its most frequent reason."""
    if not failed:
        return ""
    (end, count), = Counter(end for end, _ in failed).most_common(1)
    # Reasons that differ only in numbers count as the same; the first of them is shown.
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


def _make_headings(table: Table, units: Sequence[tuple[str, float]]) -> list[str]:
    keys = [format_heading(key, find_unit(key)) for key in table.keys]
    measured = [format_heading(column.heading, unit)
                for column, (unit, _) in zip(table.measured, units, strict=True)]  # fmt: skip
    return [*keys, "runs", *measured]


def _list_numbers(table: Table) -> list[list[float]]:
    """Return all numbers of each column with estimates."""
    columns = zip(*(estimates for *_, estimates in table.rows), strict=True)
    return [[n for e in column for n in (e.value, e.low, e.high)] for column in columns]


# Combines the texts of value, lower and upper bound; the bounds are None without an interval.
IntervalFormat = Callable[[str, str | None, str | None], str]


def _format_cells(table: Table, interval: IntervalFormat, none: str) -> list[list[str]]:
    """Return headings and cells; the numbers of a column share one format and one unit.

    none: text of a missing value.
    """
    numbers = _list_numbers(table)
    units = [choose_unit(column.unit, own)
             for column, own in zip(table.measured, numbers, strict=True)]  # fmt: skip
    formats = [make_number_format([n / size for n in own])
               for (_, size), own in zip(units, numbers, strict=True)]  # fmt: skip
    lines = [_make_headings(table, units)]
    for values, count, estimates in table.rows:
        cells = []
        for text, (_, size), e in zip(formats, units, estimates, strict=True):
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
    return "\n\n".join([text, *table.caption]) + "\n"


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


_TEX_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"''",
    "²": r"$^2$", "°": r"$^\circ$", "µ": r"$\mu$", "–": "--", "…": r"\ldots{}", "−": r"$-$",
    "×": r"$\times$", "≈": r"$\approx$", "∞": r"$\infty$", "≤": r"$\leq$", "≥": r"$\geq$",
    "λ": r"$\lambda$", "ω": r"$\omega$", "α": r"$\alpha$",
}  # fmt: skip
_TEX_NUMBERS = {"∞": r"\infty", "≈0": r"\approx 0"}


def escape_tex(text: str) -> str:
    """Return a text for LaTeX; line breaks become spaces, and brackets are no optional argument."""
    escaped = "".join(_TEX_ESCAPES.get(c, c) for c in " ".join(text.split()))
    return f"{{{escaped}}}" if escaped.startswith(("[", "*")) else escaped


def _format_tex_number(number: str) -> str:
    """Write a number for a LaTeX formula; 1e-04 becomes a power of ten."""
    sign, digits = ("-", number[1:]) if number.startswith("-") else ("", number)
    if digits in _TEX_NUMBERS:
        return sign + _TEX_NUMBERS[digits]
    digits, e, exponent = number.partition("e")
    return f"{digits} \\cdot 10^{{{int(exponent)}}}" if e else number


def _format_latex(table: Table) -> str:
    """Format a table environment for the LaTeX package booktabs.

    The failures have no column, because their text is longer than a line. Columns that do not fit
    into the width of a page follow below, with the same settings; what does not fit onto the page
    is in a second table environment.
    """
    heading, *body = _format_cells(table, _format_tex_interval, "--")
    fixed = len(table.keys) + 1
    lines = [r"% needs \usepackage{booktabs}"]
    parts_per_float = max(MAX_TEX_LINES // (len(body) + 4), 1)
    for part, measured in enumerate(_split_columns([heading, *body], fixed)):
        columns = [*range(fixed), *measured]
        if part % parts_per_float == 0:
            caption = "(continued)" if part else " ".join(map(escape_tex, table.caption))
            lines += [r"\end{table}"] if part else []
            lines += [r"\begin{table}", r"\centering", r"\small", rf"\caption{{{caption}}}"]
        lines.append(r"\par\medskip")
        alignment = "l" * len(table.keys) + "r" * (len(columns) - len(table.keys))
        lines += [rf"\begin{{tabular}}{{{alignment}}}", r"\toprule"]
        names = " & ".join(_format_tex_heading(heading[i]) for i in columns)
        lines += [names + r" \\", r"\midrule"]
        for cells in body:
            shown = [escape_tex(cells[i]) if i < fixed - 1 else cells[i] for i in columns]
            lines.append(" & ".join(shown) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}"]
    return "\n".join([*lines, r"\end{table}", ""])


def _split_columns(lines: Sequence[Sequence[str]], fixed: int) -> list[list[int]]:
    """Return the indices of the columns with estimates that fit into one width of a page each.

    fixed: number of the columns before them, which are repeated.
    """
    heading, *body = lines
    widths = [
        TEX_GAP + max(map(len, [*name.split(), *(_strip_tex(cells[i]) for cells in body)]))
        for i, name in enumerate(heading)
    ]
    parts: list[list[int]] = []
    for i in range(fixed, len(heading)):
        width = sum(widths[:fixed]) + sum(widths[k] for k in parts[-1]) if parts else 0
        if not parts or width + widths[i] > MAX_TEX_WIDTH:
            parts.append([])
        parts[-1].append(i)
    return parts


def _strip_tex(cell: str) -> str:
    """Return the letters of a cell without commands, to estimate its width."""
    return re.sub(r"\\\w+ ?|[{}$^]", "", cell)


def _format_tex_heading(heading: str) -> str:
    """Return a heading with one word per line."""
    lines = r"\\".join(map(escape_tex, heading.split()))
    return lines if len(heading.split()) == 1 else rf"\shortstack{{{lines}}}"


def _format_tex_interval(value: str, low: str | None, high: str | None) -> str:
    text = f"${_format_tex_number(value)}$"
    if low is None:
        return text
    bounds = f"{_format_tex_number(low)}, {_format_tex_number(high)}"
    return f"{text} {{\\footnotesize $[{bounds}]$}}"
