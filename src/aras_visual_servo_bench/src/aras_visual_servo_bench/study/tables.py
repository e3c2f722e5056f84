"""Tables of results: a row for each setting, with intervals; Markdown, CSV or LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import check_formats
from ..numbers.statistics import Estimate, median, proportion
from .results import Results

FORMATS = ("md", "csv", "tex")


@dataclass(frozen=True)
class Table:
    """Cells. keys: names of the leading columns. measured: of the estimates, with their units."""

    keys: tuple[str, ...]
    measured: tuple[tuple[str, str], ...]
    rows: tuple[tuple[tuple[object, ...], tuple[Estimate, ...]], ...]


def tabulated(
    all_results: Sequence[Results], by: Sequence[str] = (), metrics: Sequence[str] = ()
) -> Table:
    """Success with Wilson's interval, and medians with the bootstrap's, of each group of rows.

    Args:
        by: keys that make the groups; empty: the grid's and the cases'.
        metrics: names; empty: all.
    """
    first = all_results[0]
    keys = tuple(by) or first.parameters
    chosen = first.chosen(metrics)
    many = len(all_results) > 1
    lines = []
    for results in all_results:
        success = results.successes()
        numbers = [results.numbers(m.name) for m in chosen]
        for values, rows in results.groups(keys).items():
            rate = proportion(int(success[rows].sum()), len(rows))
            others = tuple(median(n[rows]) for n in numbers)
            lines.append((((results.name,) if many else ()) + values, (rate, *others)))
    names = (("study",) if many else ()) + keys
    return Table(names, (("success", ""), *((m.name, m.unit) for m in chosen)), tuple(lines))


def written(table: Table, style: str) -> str:
    """The table as text; StudyError for a style that there is not."""
    check_formats([style], FORMATS)
    return {"md": _markdown, "csv": _csv, "tex": _latex}[style](table)


def number(value: float) -> str:
    """Three digits, and no more zeros than it needs."""
    if math.isnan(value):
        return "none"
    if value and (abs(value) < 1e-3 or abs(value) >= 1e5):
        return f"{value:.2e}"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _interval(estimate: Estimate) -> str:
    if not estimate.count or math.isnan(estimate.value):
        return "none"
    return f"{number(estimate.value)} [{number(estimate.low)}, {number(estimate.high)}]"


def _heading(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _markdown(table: Table) -> str:
    heading = [*table.keys, "runs", *(_heading(*m) for m in table.measured)]
    lines = [heading, ["---"] * len(heading)]
    for values, estimates in table.rows:
        cells = [number(v) if isinstance(v, float) else str(v) for v in values]
        cells += [str(estimates[0].count), *(_interval(e) for e in estimates)]
        lines.append([cell.replace("|", "\\|") for cell in cells])
    told = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{told}\n\nRates with Wilson's 95 % interval, medians with the bootstrap's.\n"


def _csv(table: Table) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    parts = ("", "_low", "_high", "_n")
    columns = [name + part for name, _ in table.measured for part in parts]
    writer.writerow([*table.keys, *columns])
    for values, estimates in table.rows:
        numbers = [n for e in estimates for n in (e.value, e.low, e.high, e.count)]
        writer.writerow([*values, *(repr(n) if isinstance(n, float) else n for n in numbers)])
    return out.getvalue()


_SPECIAL = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "²": r"$^2$",
}  # fmt: skip


def _tex(text: str) -> str:
    return "".join(_SPECIAL.get(c, c) for c in text)


def _power(value: float) -> str:
    """A number in a formula, where 1e-04 would be read as a product with e."""
    digits, e, exponent = number(value).partition("e")
    return f"{digits} \\cdot 10^{{{int(exponent)}}}" if e and exponent else digits + e


def _latex(table: Table) -> str:
    """For the package booktabs."""
    heading = [*table.keys, "runs", *(_heading(*m) for m in table.measured)]
    lines = [
        r"\begin{tabular}{" + "l" * len(table.keys) + "r" * (len(heading) - len(table.keys)) + "}",
        r"\toprule", " & ".join(map(_tex, heading)) + r" \\", r"\midrule",
    ]  # fmt: skip
    for values, estimates in table.rows:
        cells = [_tex(number(v) if isinstance(v, float) else str(v)) for v in values]
        cells.append(str(estimates[0].count))
        for e in estimates:
            known = e.count and not math.isnan(e.value)
            cells.append(
                f"${_power(e.value)}$ {{\\small $[{_power(e.low)}, {_power(e.high)}]$}}"
                if known else "--"
            )
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])
