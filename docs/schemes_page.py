"""Write docs/schemes.md, which compares all schemes, from the result tables of the protocols.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/schemes_page.py \\
        --canonical DIR/table.csv --domain DIR/table.csv --out docs/schemes.md

Longer docstrings of the classes of schemes are part of the page.
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
from schemes_result import add_summary

from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.metrics.statistics import compare_rates, holm, proportion
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_controller.schemes import SCHEMES

HEAD = """# Schemes

This page compares all included visual servoing schemes by two published protocols and on the
case of the original paper. `rosrun aras_visual_servo_bench protocol canonical --out DIR` computes
the results of the first protocol again, and `docs/schemes_page.py` generates this page from such
results.

"""
FORMULAS = r"""## Formulas

The twist of the camera in its own optical frame is $v = (v_x, v_y, v_z, \omega_x, \omega_y,
\omega_z)$, the error $e = s - s^{\ast}$, and $\dot{s} = L v$. The proportional law computes

$$
v = -\lambda L^{+} e
$$

**Points** (`points`, `numbered_points`): for each point with normalised coordinates $(x, y)$ and
depth $Z$, the interaction matrix is

$$
L = \begin{pmatrix}
-1/Z & 0 & x/Z & x y & -(1 + x^2) & y \\
0 & -1/Z & y/Z & 1 + y^2 & -x y & -x
\end{pmatrix}
$$

**Points in 3-D** (`points_3d`, `stereo_points`): the features of each point $P = (X, Y, Z)$ are its
coordinates in the camera frame; $[P]_{\times}$ is the cross-product matrix:

$$
s = P, \qquad L = \begin{pmatrix} -I & [P]_{\times} \end{pmatrix}
$$

**Image moments** (`moments`): with the depth $Z^{\ast}$ and the area $a^{\ast}$ at the goal, the
features are as follows; [Image moments](moments.md) derives $L$:

$$
s = (x_n, y_n, a_n, \alpha), \qquad a_n = Z^{\ast} \sqrt{a^{\ast}/a}, \qquad x_n = a_n x_g,
\qquad y_n = a_n y_g
$$

**Pose** (`pose`): the features are the translation $t$ of the camera in the goal frame and the
rotation vector $\theta u$ of its rotation $R$:

$$
s = \begin{pmatrix} t \\ \theta u \end{pmatrix}, \qquad
L = \begin{pmatrix} R & 0 \\ 0 & J(\theta u) \end{pmatrix}
$$

where $J$ is the inverse right Jacobian of the rotation. `pose_camera` replaces $t$ by the position
$p$ of the points' centroid in the camera frame; the rows of $L$ for $p$ are $(-I, [p]_{\times})$.

**2 1/2 D** (`two_and_half_d`): the features are the image $(x, y)$ and the depth $Z$ of the points'
centroid, and $\theta u$. $L$ contains the rows of a point and of the pose, and the row of $\ln Z$:

$$
s = (x, y, \ln Z, \theta u), \qquad
L_{\ln Z} = \begin{pmatrix} 0 & 0 & -1/Z & -y & x & 0 \end{pmatrix}
$$

**Grey levels** (`luminance`): with the interaction matrix $L_I$ of all pixels, the twist is

$$
v = -\lambda \left( L_I^T L_I \right)^{-1} L_I^T e
$$

**Partitioned** (`partitioned`): the area $a$ and the depth $Z$ of the points and the angle $\theta$
of their first edge determine two components of the twist; the other four components follow from
$L$ of the points:

$$
v_z = \frac{\lambda Z}{2} \ln \frac{a^{\ast}}{a}, \qquad
\omega_z = \lambda (\theta - \theta^{\ast})
$$

**Predictive** (`predictive`): the scheme computes the constant twist over $N$ steps of $\Delta t$
that minimises the following sum, with a limit on the twist and with all predicted points inside the
image; $\rho$ is `effort`:

$$
\min_v \sum_{j=1}^{N} \left\lVert s + j \Delta t L v - s^{\ast} - e^{-\lambda j \Delta t}
(s - s^{\ast}) \right\rVert^2 + \rho \lVert v \rVert^2
$$

"""
DESCRIPTIONS = """## Features and schemes

The [README of the controller](../src/aras_visual_servo_controller/README.md#schemes) lists all
features and schemes with their inputs. The following features and schemes need a longer
description.
"""
DEGREES = 180.0 / math.pi
Row = Mapping[str, Any]
Rows = Sequence[Row]


def read(path: Path, criterion: str) -> list[dict[str, Any]]:
    """Read the rows of a table and add `hit`, which is True if the metric `criterion` is 1.

    Raises:
        ExperimentError: the file cannot be read.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise ExperimentError(f"cannot read {path}: {error.strerror}") from None
    return [{**row, "hit": row[criterion] in ("1", "1.0")} for row in rows]


def group_rows(rows: Rows, *keys: str) -> dict[tuple[str, ...], list[Row]]:
    """Group the rows by the values of these columns, in the order of first appearance."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def format_table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    written = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join([*written, *("| " + " | ".join(line) + " |" for line in lines)]) + "\n"


def _count_hits(rows: Rows) -> int:
    return sum(row["hit"] for row in rows)


def format_rate(rows: Rows) -> str:
    """Format the number of successes with Wilson's 95 % interval."""
    hits = _count_hits(rows)
    interval = proportion(hits, len(rows))
    return f"{hits} of {len(rows)} ({100 * interval.low:.0f}-{100 * interval.high:.0f} %)"


def _format_median(rows: Rows, key: str, form: str, factor: float = 1.0) -> str:
    """Format the median of a column; return an empty text if no row has a value."""
    values = [float(row[key]) for row in rows if row.get(key) not in ("", None, "inf", "nan")]
    return form.format(factor * float(np.median(values))) if values else ""


def _get_published(study: Study, scheme: str, column: str) -> str:
    """Return the published result of a scheme; `column` is a condition, a start, or both."""
    cases = {case.name: case for case in study.case_axes["scheme"]}
    return str(cases[scheme].elsewhere.get(column, "")) if scheme in cases else ""


def make_overview(rows: Rows, study: Study) -> str:
    """Make the table of successes, with a row per scheme and condition and a column per start."""
    starts = list(dict.fromkeys(row["start"] for row in rows))
    lines = []
    for (scheme, condition), found in group_rows(rows, "scheme", "condition").items():
        by_start = group_rows(found, "start")
        cells = []
        for start in starts:
            some = by_start.get((start,), [])
            published = _get_published(study, scheme, f"{condition}, {start}")
            cell = f"{_count_hits(some)}/{len(some)}" if some else ""
            cells.append(f"{cell} ({published})" if published else cell)
        lines.append([scheme, condition, *cells])
    return format_table(["scheme", "condition", *starts], lines)


def make_details(rows: Rows) -> str:
    """Make the table of all results, with a row per scheme, condition and start."""
    lines = []
    for key, found in group_rows(rows, "scheme", "condition", "start").items():
        reached = [row for row in found if row["hit"]]
        others = collections.Counter(row["outcome"] for row in found if not row["hit"])
        lines.append([
            *key, format_rate(found), _format_median(reached, "settled", "{:.2f}"),
            _format_median(reached, "final_distance", "{:.3f}", 1e3),
            _format_median(reached, "final_angle", "{:.3f}", DEGREES),
            _format_median(reached, "path_ratio", "{:.2f}"),
            _format_median(found, "image_excursion", "{:.2f}"),
            ", ".join(f"{word} {count}" for word, count in others.most_common(3)),
        ])  # fmt: skip
    return format_table(
        ["scheme", "condition", "task", "reached (Wilson 95 %)", "settled, s", "error, mm",
         "error, degrees", "path / straight", "excursion", "outcomes of the other runs"], lines
    )  # fmt: skip


def make_pairs_table(rows: Rows) -> str:
    """Make the table that compares each scheme with the first one.

    The runs are paired by their starts; the p-values are those of McNemar's test, corrected by
    Holm's method.
    """
    cases = group_rows(rows, "scheme")
    (first,), before = next(iter(cases.items()))
    known = {_get_run_key(row): float(row["hit"]) for row in before}
    lines, chances = [], []
    for (case,), found in list(cases.items())[1:]:
        pairs = [(known[_get_run_key(row)], float(row["hit"])) for row in found
                 if _get_run_key(row) in known]  # fmt: skip
        if not pairs:
            continue
        one, other = np.array(pairs).T
        chances.append(compare_rates(one, other, paired=True).p)
        lines.append([case, f"{len(one)}", f"{100 * (other.mean() - one.mean()):+.1f}",
                      f"{int((other > one).sum())}", f"{int((other < one).sum())}"])  # fmt: skip
    for line, p in zip(lines, holm(chances), strict=True):
        line.append("below 0.001" if p < 1e-3 else f"{p:.3f}")
    heads = ["scheme", "pairs", f"difference to '{first}', percentage points",
             "reached only by this scheme", f"reached only by '{first}'", "p"]  # fmt: skip
    return format_table(heads, lines)


def _get_run_key(row: Row) -> tuple[str, ...]:
    return row["condition"], row["start"], row["seed"]


def make_domain_table(rows: Rows, study: Study) -> str:
    """Make the table of a convergence domain, with a row per scheme and condition.

    It also shows published results.
    """
    lines = []
    for (case, condition), found in group_rows(rows, "scheme", "condition").items():
        reached = [row for row in found if row["hit"]]
        others = collections.Counter(row["outcome"] for row in found if not row["hit"])
        published = _get_published(study, case, condition)
        lines.append([
            case, condition, format_rate(found), published,
            _format_median(reached, "iterations", "{:.0f}"),
            _format_median(reached, "path_ratio", "{:.2f}"),
            ", ".join(f"{word} {count}" for word, count in others.most_common(3)),
        ])  # fmt: skip
    return format_table(
        ["scheme", "condition", "converged (Wilson 95 %)", "published", "images",
         "path / straight", "outcomes of the other runs"], lines
    )  # fmt: skip


def make_descriptions() -> str:
    """Describe the schemes and features whose docstrings have more than one paragraph."""
    parts = [DESCRIPTIONS]
    for name, cls in SCHEMES.items():
        text = (inspect.getdoc(cls) or "").split("Attributes:")[0].strip().replace("*", r"\*")
        if "\n\n" in text:
            parts.append(f"### `{name}`\n\n{text}\n")
    return "\n".join(parts)


def _load_study(name: str) -> Study:
    return Study.from_yaml(find_study_file(Path(name)))


def _format_choices(study: Study) -> str:
    text = (f"Source: {study.source}.\n\nThe source does not specify the following choices of this "
            "study:\n\n")  # fmt: skip
    return text + "".join(f"- {line}\n" for line in study.chosen) + "\n"


def canonical_part(path: Path, images: Path | None) -> str:
    """Write the chapter of the canonical tasks."""
    study = _load_study("canonical")
    rows = read(path, study.judged)
    page = "## Canonical tasks\n\n" + _format_choices(study)
    page += "The table lists the number of starts from which each scheme reached the goal:\n\n"
    page += make_overview(rows, study) + "\n"
    if images is not None:
        pictures.draw_paths(study, "turn 90", images / "schemes.png")
        page += ("The figure shows the paths of the target's corners in the image for the first "
                 "start with a rotation of 90 degrees:\n\n")  # fmt: skip
        page += "![paths of the corners in the image](images/schemes.png)\n\n"
    page += "The table compares every scheme with the first scheme, for the same starts:\n\n"
    page += make_pairs_table(rows) + "\n"
    page += "<details><summary>Every task: times, errors, paths</summary>\n\n" + make_details(rows)
    return page + "\n</details>\n\n"


def domain_part(path: Path, images: Path | None) -> str:
    """Write the chapter of the rendered convergence domain."""
    study = _load_study("convergence_domain")
    rows = read(path, study.judged)
    page = "## Convergence domain, rendered\n\n" + _format_choices(study)
    page += make_domain_table(rows, study) + "\n"
    if images is not None:
        pictures.draw_success_map(rows, images / "convergence_domain.png")
        page += ("The figure shows the distance and the angle of every start from the goal. A blue "
                 "dot is the start of a run that converged, and an orange cross is the start "
                 "of a run that did not converge:\n\n")  # fmt: skip
        page += "![convergence domain](images/convergence_domain.png)\n\n"
    return page


def basin_part(path: Path) -> str:
    """Write the chapter of the case of the original paper."""
    study = _load_study("paper_basin")
    rows = [{"condition": "", "start": "drawn", **row} for row in read(path, study.judged)]
    page = "## The case of the original paper\n\n" + _format_choices(study)
    return page + make_details(rows) + "\n"


def speed_part(path: Path) -> str:
    """Write the chapter of computation times from the output of tests/benchmarks/features.py.

    Raises:
        ExperimentError: the last line of the file is not the JSON text of that program.
    """
    try:
        times = json.loads(path.read_text(encoding="utf-8").strip().rpartition("\n")[2])
        ours, theirs = times["ours"], times["visp"]
    except (ValueError, KeyError, TypeError):
        raise ExperimentError(
            f"{path} does not end with the output of tests/benchmarks/features.py: run it with "
            "--visp"
        ) from None
    page = (
        "## Computation time\n\nMedian processor time of s, L and e of one image, in "
        "microseconds, for four corners or 320 x 240 pixels. `tests/benchmarks/features.py --visp` "
        "measures it, together with ViSP 3.5 of Debian (C++) on the same machine at the same time. "
        "The times of this simulator include the matching of the corners and the check that all "
        "values are finite.\n\n"
    )
    lines = [[name, f"{ours[name]:.0f}", f"{theirs[name]:.1f}" if name in theirs else ""]
             for name in ours]  # fmt: skip
    lines += [[name, "", f"{theirs[name]:.1f}"] for name in theirs if name not in ours]
    return page + format_table(["feature", "here", "ViSP"], lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Write the page and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/schemes_page.py --canonical "
                                     "out/canonical/table.csv --out page.md")
    parser.add_argument("--canonical", type=Path, required=True,
                        help="table.csv of the protocol canonical")
    parser.add_argument("--domain", type=Path, help="table.csv of the protocol convergence_domain")
    parser.add_argument("--basin", type=Path, help="table.csv of the protocol paper_basin")
    parser.add_argument("--speed", type=Path, help="output of tests/benchmarks/features.py --visp")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    parser.add_argument("--no-pictures", action="store_true", help="write only the page")
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
        page += FORMULAS + make_descriptions()
        options.out.write_text(add_summary(page), encoding="utf-8")
    except (ExperimentError, OSError) as error:
        print(f"schemes_page: {error}", file=sys.stderr)
        return 1
    print(f"wrote {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
