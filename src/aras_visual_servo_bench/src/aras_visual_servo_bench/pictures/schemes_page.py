"""The page of schemes, made of what the protocols left: every scheme with its figures.

    python3 -m aras_visual_servo_bench.pictures.schemes_page --canonical DIR/table.csv \\
        --domain DIR/table.csv --out docs/schemes.md

What a scheme is stands in its class's own words; nothing on the page is written by hand.
"""

from __future__ import annotations

import argparse
import collections
import csv
import inspect
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aras_visual_servo_controller.features.base import Feature
from aras_visual_servo_controller.schemes.registry import SCHEMES

from ..errors import ExperimentError
from ..numbers.statistics import compare_rates, holm, proportion
from ..study.protocol import Protocol
from . import schemes_pictures as pictures

HEAD = """# Schemes

Every visual servoing scheme that ships, in the field's own protocols. Made by `python3 -m
aras_visual_servo_bench.pictures.schemes_page` from the tables that the protocols leave; `rosrun
aras_visual_servo_bench protocol canonical --out DIR` makes those anew.

"""
GOAL = "goal_reached"
Row = Mapping[str, str]
Rows = Sequence[Row]


def read(path: Path) -> list[dict[str, str]]:
    """Rows of a table; ExperimentError: it cannot be read."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except OSError as error:
        raise ExperimentError(f"cannot read {path}: {error.strerror}") from None


def grouped(rows: Rows, *keys: str) -> dict[tuple[str, ...], list[Row]]:
    """Rows that are alike in these columns, in the order in which they come up."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def succeeded(row: Row) -> bool:
    """Whether the run came to its protocol's goal.

    Runs of a protocol that ends them by the truth are judged by its criterion: both distance and
    angle are a tenth of what they were.
    """
    return row["verdict"] == GOAL or row.get("by_truth") == "True" and row["reduced"] == "True"


def markdown(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table."""
    written = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join([*written, *("| " + " | ".join(line) + " |" for line in lines)]) + "\n"


def rate(rows: Rows) -> str:
    """Successes of so many, with Wilson's 95 % interval."""
    hits = sum(map(succeeded, rows))
    interval = proportion(hits, len(rows))
    return f"{hits} of {len(rows)} ({100 * interval.low:.0f}-{100 * interval.high:.0f} %)"


def _middle(rows: Rows, key: str, form: str, factor: float = 1.0) -> str:
    """Median of a column, empty where nothing is known."""
    values = [float(row[key]) for row in rows if row.get(key) not in ("", None, "inf")]
    return form.format(factor * float(np.median(values))) if values else ""


def overview(rows: Rows) -> str:
    """Successes: a line for each case and condition, a column for each start."""
    starts = list(dict.fromkeys(row["start"] for row in rows))
    lines = []
    for key, found in grouped(rows, "case", "condition").items():
        by_start = grouped(found, "start")
        counts = [by_start.get((start,), []) for start in starts]
        cells = [f"{sum(map(succeeded, c))}/{len(c)}" if c else "" for c in counts]
        lines.append([*key, *cells])
    return markdown(["scheme", "condition", *starts], lines)


def details(rows: Rows) -> str:
    """A line for each case, condition and start."""
    lines = []
    for key, found in grouped(rows, "case", "condition", "start").items():
        reached = [row for row in found if succeeded(row)]
        others = collections.Counter(row["outcome"] for row in found if not succeeded(row))
        lines.append([
            *key, rate(found), _middle(reached, "settled", "{:.2f}"),
            _middle(reached, "distance", "{:.3f}", 1e3), _middle(reached, "angle", "{:.3f}"),
            _middle(reached, "path_ratio", "{:.2f}"), _middle(found, "excursion", "{:.2f}"),
            ", ".join(f"{word} {count}" for word, count in others.most_common(3)),
        ])  # fmt: skip
    return markdown(
        ["scheme", "condition", "task", "reached (Wilson 95 %)", "settled, s", "error, mm",
         "error, degrees", "way / straight", "excursion", "the others came to"], lines
    )  # fmt: skip


def paired(rows: Rows) -> str:
    """Each case against the first one, run by run from the same starts (McNemar, Holm)."""
    cases = grouped(rows, "case")
    (first,), before = next(iter(cases.items()))
    known = {_run(row): float(succeeded(row)) for row in before}
    lines, chances = [], []
    for (case,), found in list(cases.items())[1:]:
        pairs = [(known[_run(row)], float(succeeded(row))) for row in found if _run(row) in known]
        if not pairs:
            continue
        one, other = np.array(pairs).T
        chances.append(compare_rates(one, other, paired=True).p)
        lines.append([case, f"{len(one)}", f"{100 * (other.mean() - one.mean()):+.1f}",
                      f"{int((other > one).sum())}", f"{int((other < one).sum())}"])  # fmt: skip
    for line, p in zip(lines, holm(chances), strict=True):
        line.append("below 0.001" if p < 1e-3 else f"{p:.3f}")
    heads = ["scheme", "pairs", f"success against '{first}', points", "it alone reached",
             f"'{first}' alone reached", "chance of that by luck"]  # fmt: skip
    return markdown(heads, lines)


def _run(row: Row) -> tuple[str, ...]:
    return row["condition"], row["start"], row["seed"]


def domain(rows: Rows, elsewhere: Mapping[str, Mapping[str, str]]) -> str:
    """A line for each case and condition of a convergence domain, beside what others published."""
    lines = []
    for (case, condition), found in grouped(rows, "case", "condition").items():
        reached = [row for row in found if succeeded(row)]
        others = collections.Counter(row["outcome"] for row in found if not succeeded(row))
        published = elsewhere.get(case, {}).get(condition, "")
        lines.append([
            case, condition, rate(found), published, _middle(reached, "iterations", "{:.0f}"),
            _middle(reached, "path_ratio", "{:.2f}"),
            ", ".join(f"{word} {count}" for word, count in others.most_common(3)),
        ])  # fmt: skip
    return markdown(
        ["scheme", "condition", "converged (Wilson 95 %)", "published elsewhere", "images",
         "way / straight", "the others came to"], lines
    )  # fmt: skip


def descriptions() -> str:
    """Every registered scheme and feature in its own words."""
    parts = []
    for name, cls in SCHEMES.items():
        text = inspect.getdoc(cls) or ""
        needs = ", ".join(sorted(need.value for need in getattr(cls, "needs", ())))
        kind = "feature" if issubclass(cls, Feature) else "scheme"
        parts.append(f"### `{name}`\n\n{text.split('Attributes:')[0].strip()}\n\n"
                     f"A {kind}" + (f"; needs {needs}.\n" if needs else ".\n"))  # fmt: skip
    return "\n".join(parts)


def _chosen(protocol: Protocol) -> str:
    text = f"Source: {protocol.source}.\n\nWhat was chosen where that leaves a choice:\n\n"
    return text + "".join(f"- {line}\n" for line in protocol.chosen) + "\n"


def canonical_part(path: Path, images: Path | None) -> str:
    """Of the canonical tasks."""
    protocol, rows = Protocol.load("canonical"), read(path)
    page = "## Canonical tasks\n\n" + _chosen(protocol)
    page += "Starts from which the goal was reached:\n\n" + overview(rows) + "\n"
    if images is not None:
        pictures.ways(protocol, "turn 90", images / "schemes.png")
        page += "Ways of the target's corners through the image, a turn of 90 degrees, first start:"
        page += "\n\n![ways through the image](images/schemes.png)\n\n"
    page += "Every scheme against the first one, over the same starts:\n\n" + paired(rows) + "\n"
    page += "<details><summary>Every task: times, errors, ways</summary>\n\n" + details(rows)
    return page + "\n</details>\n\n"


def domain_part(path: Path, images: Path | None) -> str:
    """Of the rendered convergence domain."""
    protocol, rows = Protocol.load("convergence_domain"), read(path)
    rows = [{**row, "by_truth": "True"} for row in rows]
    elsewhere = {case.name: case.elsewhere for case in protocol.cases}
    page = "## Convergence domain, rendered\n\n" + _chosen(protocol)
    page += domain(rows, elsewhere) + "\n"
    if images is not None:
        pictures.success_map(rows, succeeded, images / "convergence_domain.png")
        page += "Every start by its distance and angle from the goal; blue converged, red not:\n\n"
        page += "![convergence domain](images/convergence_domain.png)\n\n"
    return page


def basin_part(path: Path) -> str:
    """Of the paper's own case."""
    protocol = Protocol.load("paper_basin")
    return "## The paper's own case\n\n" + _chosen(protocol) + details(read(path)) + "\n"


def speed_part(path: Path) -> str:
    """What a measure costs, from what tests/benchmarks/features.py printed.

    Raises:
        ExperimentError: its last line is not that program's.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8").strip().rpartition("\n")[2])
        ours, theirs = told["ours"], told["visp"]
    except (ValueError, KeyError, TypeError):
        raise ExperimentError(
            f"{path} does not end with what tests/benchmarks/features.py prints: run it with --visp"
        ) from None
    page = (
        "## What a measure costs\n\nProcessor time of s, L and e of one image, microseconds, the "
        "middle of many; four corners, or 320 x 240 pixels. Made by `tests/benchmarks/features.py "
        "--visp`, beside it ViSP 3.5 of Debian, C++, in the same minute on the same machine. Ours "
        "besides finds which corner is which, and looks for what is not finite.\n\n"
    )
    lines = [[name, f"{ours[name]:.0f}", f"{theirs[name]:.1f}" if name in theirs else ""]
             for name in ours]  # fmt: skip
    lines += [[name, "", f"{theirs[name]:.1f}"] for name in theirs if name not in ours]
    return page + markdown(["feature", "here", "ViSP"], lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Write the page; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--canonical", type=Path, required=True, help="table.csv of that protocol")
    parser.add_argument("--domain", type=Path, help="table.csv of convergence_domain")
    parser.add_argument("--basin", type=Path, help="table.csv of paper_basin")
    parser.add_argument("--speed", type=Path, help="what tests/benchmarks/features.py printed")
    parser.add_argument("--out", type=Path, required=True, help="the page")
    parser.add_argument("--no-pictures", action="store_true")
    options = parser.parse_args(argv)
    images = None if options.no_pictures else options.out.parent / "images"
    try:
        page = HEAD + canonical_part(options.canonical, images)
        if options.domain is not None:
            page += domain_part(options.domain, images)
        if options.basin is not None:
            page += basin_part(options.basin)
        if options.speed is not None:
            page += speed_part(options.speed)
        page += "## What each is\n\n" + descriptions()
        options.out.write_text(page, encoding="utf-8")
    except (ExperimentError, OSError) as error:
        print(f"schemes_page: {error}", file=sys.stderr)
        return 1
    print(f"wrote {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
