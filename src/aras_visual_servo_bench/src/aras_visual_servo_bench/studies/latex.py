"""Tables and figures as LaTeX environments for a two-column paper."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

# widths of a column and of the text of a two-column paper, pt
COLUMN_WIDTH, TEXT_WIDTH = 252.0, 516.0
# Widths of a letter, of a punctuation mark and of the gap between columns, pt, in Computer Modern
# of 9 points (`\small`), which is wider than Times.
LETTER_WIDTH, PUNCTUATION_WIDTH, COLUMN_GAP = 4.7, 2.6, 12.0
# font size of a confidence interval (8 points) relative to that of a cell (9 points)
INTERVAL_SCALE = 0.92
CAPTION_LETTERS = 105  # number of letters in a line of a caption that has the width of the text
# largest number of lines of a table with its caption; a page of IEEEtran has 58 lines
MAX_FLOAT_LINES = 50
# Number of lines of a table in addition to its rows of values, for example its rules and heading.
LINES_AROUND = 6

_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"''",
    "²": r"$^2$", "°": r"$^\circ$", "µ": r"$\mu$", "–": "--", "…": r"\ldots{}", "−": r"$-$",
    "×": r"$\times$", "≈": r"$\approx$", "∞": r"$\infty$", "≤": r"$\leq$", "≥": r"$\geq$",
    "λ": r"$\lambda$", "ω": r"$\omega$", "α": r"$\alpha$",
}  # fmt: skip
_NUMBERS = {"∞": r"\infty", "≈0": r"\approx 0"}


def escape_tex(text: str) -> str:
    """Return a text with the special characters of LaTeX escaped.

    Line breaks become spaces. A text that starts with [ or * is put into braces, because LaTeX
    would read it as an argument of the command before it.
    """
    escaped = "".join(_ESCAPES.get(c, c) for c in " ".join(text.split()))
    return f"{{{escaped}}}" if escaped.startswith(("[", "*")) else escaped


def format_tex_number(number: str) -> str:
    """Write a number for a LaTeX formula; 1e-04 becomes a power of ten."""
    sign, digits = ("-", number[1:]) if number.startswith("-") else ("", number)
    if digits in _NUMBERS:
        return sign + _NUMBERS[digits]
    digits, e, exponent = number.partition("e")
    return f"{digits} \\cdot 10^{{{int(exponent)}}}" if e else number


def format_tex_interval(value: str, low: str | None, high: str | None) -> str:
    """Write a value with its confidence interval; `low` and `high` are None if there is none."""
    text = f"${format_tex_number(value)}$"
    if low is None:
        return text
    bounds = f"{format_tex_number(low)}, {format_tex_number(high)}"
    return f"{text} {{\\footnotesize $[{bounds}]$}}"


def format_tex_figure(file: str, caption: Sequence[str]) -> str:
    """Return a figure environment for LaTeX's package graphicx.

    file: name of the file with the figure.
    caption: sentences of the caption.
    """
    return "\n".join([
        r"\begin{figure}", r"\centering", rf"\includegraphics[width=\columnwidth]{{{file}}}",
        rf"\caption{{{' '.join(map(escape_tex, caption))}}}", r"\end{figure}", "",
    ])  # fmt: skip


def format_tex_table(
    heading: Sequence[str], body: Sequence[Sequence[str]], fixed: int, caption: Sequence[str],
    notes: Sequence[str] = (),
) -> str:  # fmt: skip
    r"""Return table environments for LaTeX's package booktabs.

    A table that fits into a column of a two-column paper is a `table`. A wider one is a `table*`,
    which extends over both columns. A table that is even wider is divided into parts, one below the
    other, and each part repeats the first `fixed` columns. Parts that do not fit onto the page are
    put into another environment.

    Args:
        heading: heading of each column.
        body: cells of each row, as LaTeX code.
        fixed: number of the columns at the left that every part of the table repeats.
        caption: sentences of the caption.
        notes: sentences below the table.
    """
    parts, name = _split_columns(heading, body, fixed, COLUMN_WIDTH), "table"
    if len(parts) > 1:
        parts, name = _split_columns(heading, body, fixed, TEXT_WIDTH), "table*"
    text, remarks = (" ".join(map(escape_tex, sentences)) for sentences in (caption, notes))
    letters = len(text) + len(remarks)
    free = max(MAX_FLOAT_LINES - letters // CAPTION_LETTERS, 2 * LINES_AROUND)
    rows = free - LINES_AROUND  # largest number of rows of values in one tabular
    lines, floats = [r"% needs \usepackage{booktabs}"], 0
    for columns, first in itertools.product(parts, range(0, len(body), rows)):
        tabular = _make_tabular(heading, body[first : first + rows], fixed, columns)
        if len(tabular) > free or not floats:
            lines += [rf"\end{{{name}}}"] if floats else []
            text, free = ("(continued)", MAX_FLOAT_LINES) if floats else (text, free)
            lines += [rf"\begin{{{name}}}", r"\centering", r"\small", rf"\caption{{{text}}}"]
            floats += 1
        free -= len(tabular)
        lines += [r"\par\medskip", *tabular]
    lines += [rf"\par\smallskip{{\footnotesize\raggedright {remarks}\par}}"] if remarks else []
    return "\n".join([*lines, rf"\end{{{name}}}", ""])


def _make_tabular(
    heading: Sequence[str], body: Sequence[Sequence[str]], fixed: int, measured: Sequence[int]
) -> list[str]:
    """Return the lines of a tabular with the columns 0 to fixed - 1 and the columns `measured`."""
    columns = [*range(fixed), *measured]
    alignment = "l" * (fixed - 1) + "r" * (len(columns) - fixed + 1)
    lines = [[_format_heading(heading[i]) for i in columns],
             *([row[i] for i in columns] for row in body)]  # fmt: skip
    head, *rows = (" & ".join(cells) + r" \\" for cells in lines)
    return [rf"\begin{{tabular}}{{{alignment}}}", r"\toprule", head, r"\midrule", *rows,
            r"\bottomrule", r"\end{tabular}"]  # fmt: skip


def _split_columns(
    heading: Sequence[str], body: Sequence[Sequence[str]], fixed: int, max_width: float
) -> list[list[int]]:
    """Divide the columns after the first `fixed` ones into parts; return the indices of each part.

    fixed: number of the first columns, which every part repeats.
    max_width: largest width of a part, pt.
    """
    widths = [
        COLUMN_GAP + max(map(_estimate_width, [*name.split(), *(row[i] for row in body)]))
        for i, name in enumerate(heading)
    ]
    parts: list[list[int]] = []
    for i in range(fixed, len(heading)):
        width = sum(widths[:fixed]) + sum(widths[k] for k in parts[-1]) if parts else 0
        if not parts or width + widths[i] > max_width:
            parts.append([])
        parts[-1].append(i)
    return parts


def _estimate_width(cell: str) -> float:
    """Estimate the width of the text of a cell, pt."""
    width = 0.0
    for part, scale in zip(cell.split(r"\footnotesize "), (1.0, INTERVAL_SCALE), strict=False):
        text = re.sub(r"\\([A-Za-z]+ ?|.)", "x", part)  # count each LaTeX command as one character
        text = re.sub(r"[{}$^]", "", text)
        narrow = sum(text.count(character) for character in ".,[] ")
        width += scale * (PUNCTUATION_WIDTH * narrow + LETTER_WIDTH * (len(text) - narrow))
    return width


def _format_heading(heading: str) -> str:
    """Return a heading with one word per line."""
    words = heading.split()
    lines = r"\\".join(map(escape_tex, words))
    return lines if len(words) == 1 else rf"\shortstack{{{lines}}}"
