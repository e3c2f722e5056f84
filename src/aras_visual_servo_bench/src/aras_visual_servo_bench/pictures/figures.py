"""Pictures of results: where it succeeds, how metrics are spread, what they depend on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..asked.experiment_keys import unit_of
from ..errors import check_formats, writing
from ..numbers.metrics import Metric
from ..numbers.printing import amount, headed, word
from ..numbers.statistics import proportion
from ..study import folder as folders
from ..study.folder import Folder
from ..study.results import REAL_TIME, Results
from .palette import BLUE, COLOURS, INK, PALE, SOFT, VERMILION, letters_on
from .style import KINDS, literal, look, panels

MOST_GROUPS = 24  # boxes beside each other that can still be read
MOST_CURVES = 8  # in a panel
MOST_TRACES = 200
COLUMNS, WIDTH = 3, 3.8  # panels in a row, and inches of each


def write_all(
    all_results: Sequence[Results], folder: Path, kinds: Sequence[str] = ("png",),
    metrics: Sequence[str] = (), paths: Sequence[Path] = (),
) -> list[Path]:  # fmt: skip
    """Draw what these results can show.

    Args:
        kinds: of png, svg and pdf. metrics: names; empty: all that vary.
        paths: of the results' folders, for traces.

    Raises:
        StudyError: a kind that there is not, or a folder that cannot be written.
    """
    check_formats(kinds, KINDS)
    chosen = [m for m in all_results[0].chosen(metrics) if metrics or m != REAL_TIME]
    chosen = [m for m in chosen if _shows(m, all_results) or metrics]
    drawings: dict[str, Callable[[], Figure | None]] = {
        "success": lambda: success(all_results),
        "distributions": lambda: distributions(all_results, chosen),
        "boxes": lambda: boxes(all_results, chosen),
        "sensitivity": lambda: sensitivity(all_results[0], chosen),
        "trajectories": lambda: trajectories(paths),
    }
    written: list[Path] = []
    with writing(f"into {folder}"), look():
        folder.mkdir(parents=True, exist_ok=True)
        for name, draw in drawings.items():
            figure = draw()
            if figure is None:
                continue
            for kind in kinds:
                written.append(folder / f"{name}.{kind}")
                figure.savefig(written[-1])
            plt.close(figure)
    return written


def _shows(metric: Metric, all_results: Sequence[Results]) -> bool:
    """Whether it is not the same in all runs."""
    values = np.concatenate([r.numbers(metric.name) for r in all_results])
    known = values[np.isfinite(values)]
    return known.size > 0 and bool(np.ptp(known) > 0.0)


def success(all_results: Sequence[Results]) -> Figure | None:
    """A map over two keys that take several values, bars over one, or over the studies."""
    keys = [k for k in all_results[0].parameters if len(set(map(str, _values(all_results, k)))) > 1]
    if len(keys) >= 2:
        return _success_maps(all_results, *keys[-2:])
    return _success_bars(all_results, keys)


def _values(all_results: Iterable[Results], key: str) -> list:
    """Different values of a column, in order of appearance."""
    return list(dict.fromkeys(v for r in all_results for v in r.column(key)))


def _success_bars(all_results: Sequence[Results], keys: Sequence[str]) -> Figure:
    names, rates = [], []
    for results in all_results:
        hits = results.successes()
        for values, rows in results.groups(keys).items():
            name = ", ".join(map(_word, values))
            if len(all_results) > 1 or not name:
                name = f"{literal(results.name)} {name}".strip()
            names.append(name)
            rates.append(proportion(int(hits[rows].sum()), len(rows)))
    figure, (axis,) = panels(1, 0.42 * len(names) + 1.5, width=6.5)
    rows = np.arange(len(names))[::-1]
    value = np.array([100.0 * r.value for r in rates])
    spread = np.array([[100.0 * max(r.value - r.low, 0.0), 100.0 * max(r.high - r.value, 0.0)]
                       for r in rates]).T  # fmt: skip
    axis.barh(rows, value, color=BLUE, height=0.65)
    axis.errorbar(value, rows, xerr=spread, fmt="none", ecolor=INK, capsize=3, lw=1.1)
    axis.set_yticks(rows, names)
    axis.set(xlim=(0.0, 103.0), xlabel="runs with success (%), Wilson's 95 % interval",
             title=f"Success by {_named(keys[0])}" if keys else "Success")
    axis.yaxis.grid(False)
    return figure


def _success_maps(all_results: Sequence[Results], down: str, across: str) -> Figure:
    columns, lines = _values(all_results, across), _values(all_results, down)
    count = len(all_results)
    figure, axes = panels(
        count, max(0.55 * len(lines), 1.6) + 1.4, count,
        width=max(0.9 * len(columns), 3.0) + 2.2 / count, sharey=True,
    )  # fmt: skip
    for axis, results in zip(axes, all_results, strict=True):
        hits = results.successes()
        cells = np.full((len(lines), len(columns)), np.nan)
        image = axis.imshow(cells, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto")
        for (line, column), rows in results.groups((down, across)).items():
            rate = proportion(int(hits[rows].sum()), len(rows))
            i, j = lines.index(line), columns.index(column)
            cells[i, j] = 100.0 * rate.value
            axis.text(j, i, f"{int(hits[rows].sum())}/{len(rows)}", ha="center", va="center",
                      color=letters_on(image.cmap(rate.value)), fontsize=9)
        image.set_data(cells)
        axis.grid(False)
        axis.set_xticks(range(len(columns)), map(_word, columns))
        axis.set_yticks(range(len(lines)), map(_word, lines))
        axis.set(xlabel=_named(across), title=literal(results.name) if count > 1 else "Success")
    axes[0].set_ylabel(_named(down))
    figure.colorbar(image, ax=axes, label="runs with success (%)", shrink=0.9)
    return figure


def _grouped(
    all_results: Sequence[Results], most: int = MOST_GROUPS
) -> list[tuple[str, Results, np.ndarray]]:
    """Name, results and rows of what is drawn beside each other: few groups, by few keys."""
    keys = [k for k in all_results[0].parameters if len(set(map(str, _values(all_results, k)))) > 1]
    while keys and sum(len(r.groups(keys)) for r in all_results) > most:
        keys = keys[:-1]
    found = []
    for results in all_results:
        for values, rows in results.groups(keys).items():
            name = ", ".join(
                f"{literal(k)} {amount(_word(v), unit_of(k))}"
                for k, v in zip(keys, values, strict=True)
            )
            if len(all_results) > 1 or not name:
                name = f"{literal(results.name)} {name}".strip()
            found.append((name, results, rows))
    return found


def distributions(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Part of the runs below each value, a panel a metric, a curve a group."""
    if not metrics:
        return None
    groups = _grouped(all_results, MOST_CURVES)
    figure, axes = panels(len(metrics), 3.0, min(len(metrics), COLUMNS), width=WIDTH)
    for axis, metric in zip(axes, metrics, strict=True):
        for i, (name, results, rows) in enumerate(groups):
            values = results.numbers(metric.name)[rows]
            known = np.sort(values[np.isfinite(values)])
            if not known.size:
                continue
            # What has no value, as a run that never settles, keeps the curve below the top.
            part = np.arange(known.size + 1) / values.size
            style = {"color": COLOURS[i % len(COLOURS)], "ls": "-" if i < len(COLOURS) else "--"}
            axis.step(np.append(known[0], known), 100.0 * part, where="post", label=name, **style)
        _scale(axis, "x", [r.numbers(metric.name)[rows] for _, r, rows in groups])
        axis.set(xlabel=_label(metric), ylim=(0.0, 103.0))
    axes[0].set_ylabel("runs below (%)")
    return _with_legend(figure, axes[0], len(groups))


def boxes(all_results: Sequence[Results], metrics: Sequence[Metric]) -> Figure | None:
    """Median, quartiles and what lies outside, a panel a metric, a box a group."""
    groups = _grouped(all_results)
    if not metrics or len(groups) < 2:
        return None
    columns = min(len(metrics), COLUMNS)
    figure, axes = panels(len(metrics), 0.3 * len(groups) + 1.4, columns, width=WIDTH)
    for number_, (axis, metric) in enumerate(zip(axes, metrics, strict=True)):
        values = [r.numbers(metric.name)[rows] for _, r, rows in groups]
        known = [v[np.isfinite(v)] for v in values]
        axis.boxplot(
            known[::-1], orientation="horizontal", widths=0.6, patch_artist=True,
            boxprops={"facecolor": PALE, "edgecolor": BLUE},
            medianprops={"color": VERMILION, "lw": 1.6}, whiskerprops={"color": BLUE},
            capprops={"color": BLUE},
            flierprops={"marker": ".", "markersize": 4, "markeredgecolor": SOFT},
        )  # fmt: skip
        _scale(axis, "x", values)
        axis.set_xlabel(_label(metric))
        first = number_ % columns == 0
        axis.set_yticks(range(1, len(groups) + 1),
                        [name for name, *_ in groups[::-1]] if first else [])
        axis.yaxis.grid(False)
    return figure


def sensitivity(results: Results, metrics: Sequence[Metric]) -> Figure | None:
    """How strongly each metric follows each number that varies: Spearman's rank correlation."""
    keys = []
    for key in results.study.keys:
        values = results.column(key) if key in results.table.column_names else []
        if len(set(values)) > 2 and all(isinstance(v, int | float) for v in values):
            keys.append(key)
    names = [m for m in metrics if m != REAL_TIME]
    if not keys or not names or results.table.num_rows < 4:
        return None
    cells = np.full((len(names), len(keys)), np.nan)
    for i, metric in enumerate(names):
        measured = results.numbers(metric.name)
        for j, key in enumerate(keys):
            varied = results.numbers(key)
            known = np.isfinite(measured) & np.isfinite(varied)
            if known.sum() > 3 and np.ptp(measured[known]) and np.ptp(varied[known]):
                cells[i, j] = scipy.stats.spearmanr(varied[known], measured[known]).statistic
    figure, (axis,) = panels(1, 0.38 * len(names) + 1.6, width=1.1 * len(keys) + 3.6)
    image = axis.imshow(cells, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    axis.grid(False)
    for (i, j), value in np.ndenumerate(cells):
        if np.isfinite(value):
            axis.text(j, i, f"{value:+.2f}", ha="center", va="center", fontsize=9,
                      color=letters_on(image.cmap(0.5 + 0.5 * value)))
    axis.set_xticks(range(len(keys)), map(literal, keys), rotation=20 if len(keys) > 3 else 0)
    axis.set_yticks(range(len(names)), [m.name for m in names])
    axis.set_title("What follows what")
    figure.colorbar(image, ax=axis, label="rank correlation (Spearman)", shrink=0.9)
    return figure


def trajectories(paths: Sequence[Path]) -> Figure | None:
    """Errors of all runs over each other, and the camera's paths seen from above and the side."""
    traced = [folder for folder in map(Folder.open, paths) if folder.study.traces]
    if not traced:
        return None
    figure, axes = panels(3, 3.8, 3, width=4.0)
    for colour, folder in zip(COLOURS, traced, strict=False):
        table = folder.results(folders.TRACES)
        run, stamp = np.array(table["run"]), np.array(table["stamp"])
        runs = np.unique(run)
        for n, one in enumerate(runs[:: max(len(runs) // MOST_TRACES, 1)]):
            rows = table.take(np.flatnonzero(run == one))
            error = np.array(rows["error"].to_pylist(), float)
            time = stamp[run == one] - stamp[run == one][0]
            norm = np.linalg.norm(error, axis=1)
            label = literal(folder.path.resolve().name) if n == 0 else None
            known = norm[np.isfinite(norm)]
            if not known.size:
                continue  # it never saw its target
            axes[0].semilogy(time, norm / known[0], color=colour, lw=0.7, alpha=0.5, label=label)
            places = np.array(rows["pose"].to_pylist(), float).reshape(-1, 4, 4)[:, :3, 3]
            for axis, (i, j) in ((axes[1], (0, 1)), (axes[2], (0, 2))):
                axis.plot(places[:, i], places[:, j], color=colour, lw=0.7, alpha=0.5)
                axis.plot(places[-1, i], places[-1, j], ".", color=INK, ms=4)
    axes[0].set(xlabel="time since the first image (s)", ylabel="error, parts of the first")
    axes[1].set(xlabel="x (m)", ylabel="y (m)", title="The camera's paths")
    axes[2].set(xlabel="x (m)", ylabel="z (m)")
    for axis in axes[1:]:
        axis.set_aspect("equal", adjustable="datalim")
        axis.locator_params(nbins=5)
    if len(traced) > 1:
        axes[0].legend()
    return figure


def _with_legend(figure: Figure, axis: Axes, count: int) -> Figure:
    handles, labels = axis.get_legend_handles_labels()
    if count > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=min(count, 3))
    return figure


def _scale(axis: Axes, side: str, values: Sequence[np.ndarray]) -> None:
    """Logarithmic where what is shown spans more than two decades."""
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if known.size and known.min() > 0.0 and known.max() > 100.0 * known.min():
        getattr(axis, f"set_{side}scale")("log")
    elif side == "x":
        axis.locator_params(axis="x", nbins=5)


def _label(metric: Metric) -> str:
    return literal(headed(metric.name.replace("_", " "), metric.unit))


def _named(key: str) -> str:
    """A setting beside an axis, with its unit."""
    return literal(headed(key, unit_of(key)))


def _word(value: object) -> str:
    return literal(word(value))
