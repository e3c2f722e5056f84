"""The page of schemes, made of what the protocols left: every scheme with its figures.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/schemes_page.py \\
        --canonical DIR/table.csv --domain DIR/table.csv --out docs/schemes.md

What a scheme is stands in its class's own words; nothing on the page is written by hand.
"""

from __future__ import annotations

import argparse
import collections
import csv
import inspect
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import schemes_pictures as pictures
from schemes_result import with_result

from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.metrics.statistics import compare_rates, holm, proportion
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_controller.features.base import Feature
from aras_visual_servo_controller.schemes import SCHEMES

HEAD = """# Schemes

Every visual servoing scheme that ships, in the field's own protocols. Made by
`docs/schemes_page.py` from the tables that the protocols leave; `rosrun aras_visual_servo_bench
protocol canonical --out DIR` makes those anew.

"""
DEGREES = 180.0 / math.pi
Row = Mapping[str, Any]
Rows = Sequence[Row]


def read(path: Path, criterion: str) -> list[dict[str, Any]]:
    """Rows of a table, `hit` where the metric of that name is 1; ExperimentError: unreadable."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise ExperimentError(f"cannot read {path}: {error.strerror}") from None
    return [{**row, "hit": row[criterion] in ("1", "1.0")} for row in rows]


def grouped(rows: Rows, *keys: str) -> dict[tuple[str, ...], list[Row]]:
    """Rows that are alike in these columns, in the order in which they come up."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def markdown(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table."""
    written = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join([*written, *("| " + " | ".join(line) + " |" for line in lines)]) + "\n"


def _hits(rows: Rows) -> int:
    return sum(row["hit"] for row in rows)


def rate(rows: Rows) -> str:
    """Successes of so many, with Wilson's 95 % interval."""
    hits = _hits(rows)
    interval = proportion(hits, len(rows))
    return f"{hits} of {len(rows)} ({100 * interval.low:.0f}-{100 * interval.high:.0f} %)"


def _middle(rows: Rows, key: str, form: str, factor: float = 1.0) -> str:
    """Median of a column, empty where nothing is known."""
    values = [float(row[key]) for row in rows if row.get(key) not in ("", None, "inf", "nan")]
    return form.format(factor * float(np.median(values))) if values else ""


def _elsewhere(study: Study, scheme: str, column: str) -> str:
    """What others have published of a scheme, by condition, start, or condition and start."""
    cases = {case.name: case for case in study.case_axes["scheme"]}
    return str(cases[scheme].elsewhere.get(column, "")) if scheme in cases else ""


def overview(rows: Rows, study: Study) -> str:
    """Successes: a line for each scheme and condition, a column for each start."""
    starts = list(dict.fromkeys(row["start"] for row in rows))
    lines = []
    for (scheme, condition), found in grouped(rows, "scheme", "condition").items():
        by_start = grouped(found, "start")
        cells = []
        for start in starts:
            some = by_start.get((start,), [])
            theirs = _elsewhere(study, scheme, f"{condition}, {start}")
            cells.append(f"{_hits(some)}/{len(some)}" * bool(some) + f" ({theirs})" * bool(theirs))
        lines.append([scheme, condition, *cells])
    return markdown(["scheme", "condition", *starts], lines)


def details(rows: Rows) -> str:
    """A line for each case, condition and start."""
    lines = []
    for key, found in grouped(rows, "scheme", "condition", "start").items():
        reached = [row for row in found if row["hit"]]
        others = collections.Counter(row["outcome"] for row in found if not row["hit"])
        lines.append([
            *key, rate(found), _middle(reached, "settled", "{:.2f}"),
            _middle(reached, "final_distance", "{:.3f}", 1e3),
            _middle(reached, "final_angle", "{:.3f}", DEGREES),
            _middle(reached, "path_ratio", "{:.2f}"), _middle(found, "image_excursion", "{:.2f}"),
            ", ".join(f"{word} {count}" for word, count in others.most_common(3)),
        ])  # fmt: skip
    return markdown(
        ["scheme", "condition", "task", "reached (Wilson 95 %)", "settled, s", "error, mm",
         "error, degrees", "path / straight", "excursion", "the others came to"], lines
    )  # fmt: skip


def paired(rows: Rows) -> str:
    """Each case against the first one, run by run from the same starts (McNemar, Holm)."""
    cases = grouped(rows, "scheme")
    (first,), before = next(iter(cases.items()))
    known = {_run(row): float(row["hit"]) for row in before}
    lines, chances = [], []
    for (case,), found in list(cases.items())[1:]:
        pairs = [(known[_run(row)], float(row["hit"])) for row in found if _run(row) in known]
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


def domain(rows: Rows, study: Study) -> str:
    """A line for each case and condition of a convergence domain, beside what others published."""
    lines = []
    for (case, condition), found in grouped(rows, "scheme", "condition").items():
        reached = [row for row in found if row["hit"]]
        others = collections.Counter(row["outcome"] for row in found if not row["hit"])
        published = _elsewhere(study, case, condition)
        lines.append([
            case, condition, rate(found), published, _middle(reached, "iterations", "{:.0f}"),
            _middle(reached, "path_ratio", "{:.2f}"),
            ", ".join(f"{word} {count}" for word, count in others.most_common(3)),
        ])  # fmt: skip
    return markdown(
        ["scheme", "condition", "converged (Wilson 95 %)", "published elsewhere", "images",
         "path / straight", "the others came to"], lines
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


def _study(name: str) -> Study:
    return Study.from_yaml(find_study_file(Path(name)))


def _chosen(study: Study) -> str:
    text = f"Source: {study.source}.\n\nWhat was chosen where that leaves a choice:\n\n"
    return text + "".join(f"- {line}\n" for line in study.chosen) + "\n"


def canonical_part(path: Path, images: Path | None) -> str:
    """Of the canonical tasks."""
    study = _study("canonical")
    rows = read(path, study.judged)
    page = "## Canonical tasks\n\n" + _chosen(study)
    page += "Starts from which the goal was reached:\n\n" + overview(rows, study) + "\n"
    if images is not None:
        pictures.ways(study, "turn 90", images / "schemes.png")
        page += ("Paths of the target's corners through the image, a turn of 90 degrees, first "
                 "start:\n\n")  # fmt: skip
        page += "![paths through the image](images/schemes.png)\n\n"
    page += "Every scheme against the first one, over the same starts:\n\n" + paired(rows) + "\n"
    page += "<details><summary>Every task: times, errors, paths</summary>\n\n" + details(rows)
    return page + "\n</details>\n\n"


def domain_part(path: Path, images: Path | None) -> str:
    """Of the rendered convergence domain."""
    study = _study("convergence_domain")
    rows = read(path, study.judged)
    page = "## Convergence domain, rendered\n\n" + _chosen(study) + domain(rows, study) + "\n"
    if images is not None:
        pictures.success_map(rows, images / "convergence_domain.png")
        page += ("Every start by its distance and angle from the goal; blue dots converged, orange "
                 "crosses did not:\n\n")  # fmt: skip
        page += "![convergence domain](images/convergence_domain.png)\n\n"
    return page


def basin_part(path: Path) -> str:
    """Of the paper's own case."""
    study = _study("paper_basin")
    rows = [{"condition": "", "start": "drawn", **row} for row in read(path, study.judged)]
    return "## The paper's own case\n\n" + _chosen(study) + details(rows) + "\n"


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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/schemes_page.py --canonical "
                                     "out/canonical/table.csv --out page.md")
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
        options.out.write_text(with_result(page), encoding="utf-8")
    except (ExperimentError, OSError) as error:
        print(f"schemes_page: {error}", file=sys.stderr)
        return 1
    print(f"wrote {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
