"""Writing of reports: a folder with a page, figures, tables and metrics."""

from __future__ import annotations

import csv
import gc
import io
import json
import math
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from aras_visual_servo_base.names import describe_unknown

from ...errors import BenchError, catch_write_errors, check_formats
from ...metrics.formatting import make_printable
from ...metrics.run_tables import TableColumn, make_image_columns, make_joint_columns
from ...metrics.summary import Quantity, make_mapping, summarise
from ...plots import camera_figures, panels, style, time_plots
from ...plots.panel import Panel
from ...plots.style import FILE_FORMATS
from ...plots.time_plots import Layout
from ...recording.run import Run
from .page import make_page

FigureFunction = Callable[[Sequence[Run]], Figure | None]


@dataclass(frozen=True)
class Chapter:
    """A chapter of a report: a figure, and a group of time plots on the page.

    Attributes:
        name: name of the figure's files.
        title: heading of the group on the page.
        text: description below this heading.
        draw: function that draws the figure; None: the figure consists of the panels.
        panels: function that returns the panels (plots over time) of the chapter.
        heading, layout: heading and layout of a figure that consists of the panels.
        needs: data without which there is no figure.
    """

    name: str
    title: str
    text: str
    draw: FigureFunction | None = None
    panels: Callable[[Sequence[Run]], list[Panel]] = lambda runs: []
    heading: str = ""
    layout: Layout = Layout()
    needs: str = ""

    def draw_figure(self, runs: Sequence[Run]) -> Figure | None:
        """Draw the figure of this chapter; return None if the runs have no data for it."""
        if self.draw is not None:
            return self.draw(runs)
        return time_plots.draw_panels(self.panels(runs), runs, self.heading, self.layout)


MEASURED, POSES = "images that the scheme has measured", "true camera poses while servoing"

# Chapters of a report, by row. Figures of a row are shown side by side with equal heights.
CHAPTERS: tuple[tuple[Chapter, ...], ...] = (
    (Chapter("filmstrip", "Filmstrip", "Images of the camera while the error decreases. Green: "
             "the desired outline.", camera_figures.draw_filmstrip,
             needs="stored images: run_with_images and load_run store the images of a run"),),
    (Chapter("feature_errors", "Errors", "Errors of the features by unit, and the norm of all "
             "errors, each divided by its maximum.", None, panels.make_error_panels,
             "Feature errors s − s*", Layout(1.75, legend_columns=6), MEASURED),
     Chapter("pose_errors", "Pose", "Errors of the camera's true pose.",
             None, panels.make_pose_panels, "Distance of the camera from its goal", Layout(1.9),
             POSES)),
    (Chapter("features", "Features", "Measured features, and desired features (dashed).", None,
             panels.make_feature_panels, "Features s", Layout(2.0, legend_columns=6),
             "a single run with images that the scheme has measured"),
     Chapter("camera_twist", "Twist", "Twist in the optical frame of the camera: x right, y "
             "down, z forward. Dashed: desired twist.", None, panels.make_twist_panels,
             "Twist of the camera", Layout(2.1), MEASURED)),
    (Chapter("image_trajectory", "Image plane", "Trajectories in the image, drawn on the last "
             "image.", camera_figures.draw_image_trajectory, needs=MEASURED),
     Chapter("camera_path", "Path", "Path of the camera in the world frame. Drawn cameras "
             "open along their optical axis.", camera_figures.draw_camera_path, needs=POSES)),
    (Chapter("joint_positions", "Joints", "Red: limits in the robot description.", None,
             panels.make_joint_panels, "Positions",
             Layout(1.25, columns=2, second_column="Speeds"),
             "joints that move the camera"),),
    (Chapter("conditioning", "Conditioning", "Condition number of L, without components of the "
             "twist that the scheme does not control, and of L J, which the controller inverts. "
             "Scale: factor by which speed and acceleration limits reduce the desired twist.", None,
             panels.make_conditioning_panels, "Conditioning", Layout(1.5), MEASURED),
     Chapter("timing", "Timing", "All times are simulated times. The simulator reports the "
             "real-time factor. A negative delay means that an image arrived before the clock "
             "message with its time.", None, panels.make_timing_panels, "Time between images",
             Layout(1.5), "at least three images")),
)  # fmt: skip
# Number of processes that draw figures. More processes would not help, because the slowest row of
# chapters determines the time.
DRAWING_PROCESSES = 2
# metadata of figures without the date, so that equal figures have equal files
NO_DATE = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


def write_report(
    runs: Sequence[Run],
    out: Path,
    kinds: Sequence[str] = FILE_FORMATS,
    paper: bool = False,
    progress: Callable[[float, str], None] = lambda part, what: None,
) -> list[Path]:
    """Write the report of one or more runs: a page with plots and metrics, figures and tables.

    The files are report.html, summary.json, summary.csv, and those in the folders figures and data.

    Args:
        runs: one run, or several runs to compare.
        out: folder of the report, which is created if necessary. Existing files with the same names
            are overwritten.
        kinds: formats of the figures: png, svg, pdf. The page does not need these files.
        paper: True to write only vector figures, in the width of a paper's column.
        progress: function that is called with the finished fraction, 0 to 1, and the name of the
            next step.

    Returns:
        The paths of the files, the page first.

    Raises:
        BenchError: a format is unknown, or the folder is not writable.
    """
    check_formats(kinds, FILE_FORMATS)
    if not runs:
        raise BenchError("a report needs at least one run")
    with catch_write_errors(f"the report into {out}"):
        return _ReportWriter(runs, out, kinds, paper, progress).write()


def draw_figure(runs: Sequence[Run], name: str) -> Figure:
    """Draw one figure of a report.

    Args:
        runs: one run, or several runs to compare.
        name: name of the figure, equal to that of its file in the folder `figures` of a report.

    Raises:
        BenchError: the figure is unknown, or the runs have no data for it.
    """
    chapters = {chapter.name: chapter for row in CHAPTERS for chapter in row}
    if name not in chapters:
        raise BenchError(describe_unknown("figure", name, chapters))
    with style.apply_style():
        figure = chapters[name].draw_figure(runs)
    if figure is None:
        raise BenchError(f"there are no data for the figure '{name}', which needs "
                         f"{chapters[name].needs}")
    return figure


def save_figure(runs: Sequence[Run], name: str, path: str | Path) -> Figure:
    """Draw one figure of a report into a file.

    Args:
        runs: one run, or several runs to compare.
        name: name of the figure, which is the name of its file in a report's folder `figures`.
        path: path of the file. Its suffix, such as .png, .svg or .pdf, defines the format.

    Returns:
        The figure.

    Raises:
        BenchError: the figure is unknown, the runs have no data for it, or it cannot be written.
    """
    figure = draw_figure(runs, name)
    with style.apply_style(), catch_write_errors(path, BenchError):
        figure.savefig(path)
    return figure


class _ReportWriter:
    """Writes one report."""

    def __init__(
        self, runs: Sequence[Run], out: Path, kinds: Sequence[str], paper: bool,
        progress: Callable[[float, str], None],
    ) -> None:  # fmt: skip
        self.runs, self.out, self.progress = list(runs), out, progress
        self.formats, self.paper = [k for k in kinds if not (paper and k == "png")], paper
        self.files: list[Path] = []
        self._steps, self._finished_steps = (len(CHAPTERS) if self.formats else 0) + 2, 0

    def write(self) -> list[Path]:
        """Write all files of the report, and return their paths, starting with the page."""
        for folder in ("figures", "data"):
            (self.out / folder).mkdir(parents=True, exist_ok=True)
        self._report_progress("numbers")
        summaries = [summarise(run) for run in self.runs]
        self._write_numbers(summaries)
        for number, run in enumerate(self.runs):
            label = "" if len(self.runs) == 1 else f"{number + 1}_"
            tables = {"images": make_image_columns(run), "joints": make_joint_columns(run)}
            for name, columns in tables.items():
                self._write_text(self.out / "data" / f"{label}{name}.csv", _format_csv(columns))
        self._report_progress("page")
        footer = f"Written {datetime.now():%Y-%m-%d %H:%M} by aras_visual_servo_bench analyze."
        parts = [part for row in CHAPTERS for part in row]
        groups = [(p.name, p.title, p.text, p.panels(self.runs)) for p in parts]
        missing = {p.title: p.needs for p, group in zip(parts, groups, strict=True)
                   if p.draw is None and not group[-1]}  # fmt: skip
        text = make_page(self.runs, summaries, groups, missing, footer)
        self._write_text(self.out / "report.html", text)
        if self.formats:
            for number, written in self._draw_rows():
                self._report_progress(" and ".join(part.title.lower() for part in CHAPTERS[number]))
                self.files += written
        self.progress(1.0, "done")
        return [self.out / "report.html",
                *(path for path in self.files if path.name != "report.html")]  # fmt: skip

    def _report_progress(self, what: str) -> None:
        self.progress(self._finished_steps / self._steps, what)
        self._finished_steps += 1

    def _write_text(self, path: Path, text: str) -> None:
        path.write_text(make_printable(text), encoding="utf-8")
        self.files.append(path)

    def _write_numbers(self, summaries: Sequence[Sequence[Quantity]]) -> None:
        mappings = [make_mapping(r, qs) for r, qs in zip(self.runs, summaries, strict=True)]
        values = mappings[0] if len(mappings) == 1 else mappings
        text = json.dumps(values, indent=2, ensure_ascii=False)
        self._write_text(self.out / "summary.json", text + "\n")
        stream = io.StringIO()
        rows = csv.writer(stream)
        rows.writerow(["run", "quantity", "value", "unit", "what it is"])
        for run, quantities in zip(self.runs, summaries, strict=True):
            for q in quantities:
                value = "" if isinstance(q.value, float) and math.isnan(q.value) else q.value
                rows.writerow([run.name, q.key, value, q.unit, q.text])
        self._write_text(self.out / "summary.csv", stream.getvalue())

    def _draw_rows(self) -> Iterator[tuple[int, list[Path]]]:
        """Draw all rows of figures, and yield the index and the files of each finished row.

        If this process has only one thread, two forked processes draw in parallel. If it had
        several threads, a forked process could wait forever for a lock of another thread.
        """
        alone = threading.active_count() == 1 and len(os.sched_getaffinity(0)) > 1
        if not alone or len(self.formats) == 1:
            yield from ((number, self.draw_row(number)) for number in range(len(CHAPTERS)))
            return
        fork = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(DRAWING_PROCESSES, fork, _set_shared_report, (self,)) as pool:
            try:
                for done in as_completed(pool.submit(_draw_row, n) for n in range(len(CHAPTERS))):
                    yield done.result()
            except BrokenProcessPool:
                raise BenchError(
                    "a process that drew figures was killed, probably because of too little "
                    "memory; close other programs, or write figures in one format only"
                ) from None

    def draw_row(self, number: int) -> list[Path]:
        """Draw the figures of row `number`, write them to files, and return the files' paths."""
        with style.apply_style(is_paper=self.paper):
            drawn = [(part.name, part.draw_figure(self.runs)) for part in CHAPTERS[number]]
            drawn = [(name, figure) for name, figure in drawn if figure is not None]
            if drawn and not self.paper:
                style.equalize_heights([figure for _, figure in drawn])
            written = []
            for name, figure in drawn:
                for kind in self.formats:
                    written.append(self.out / "figures" / f"{name}.{kind}")
                    figure.savefig(written[-1], format=kind, metadata=NO_DATE.get(kind))
                plt.close(figure)
        return written


def _set_shared_report(report: _ReportWriter) -> None:
    """Set the report whose figures this forked process draws."""
    global _shared
    _shared = report
    gc.disable()  # garbage collection is slow, and not needed because this process ends soon


def _draw_row(number: int) -> tuple[int, list[Path]]:
    return number, _shared.draw_row(number)


def _format_csv(columns: Mapping[str, TableColumn]) -> str:
    """Format columns as CSV with nine digits; NaN becomes an empty cell."""
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(f"{name} [{one.unit}]" if one.unit else name for name, one in columns.items())
    texts = [map(_format_cell, one.values.tolist()) for one in columns.values()]
    rows.writerows(zip(*texts, strict=True))
    return stream.getvalue()


def _format_cell(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return "" if math.isnan(value) else f"{value:.9g}"
