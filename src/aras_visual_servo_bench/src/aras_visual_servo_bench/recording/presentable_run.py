"""Presentation of a run in notebooks and scripts: text, notebook card, figures, report and table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aras_visual_servo_base.lazy_imports import import_later

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

PACKAGE = "aras_visual_servo_bench"


class PresentableRun:
    """Presentation of a run; base class of `Run`.

    The modules that make figures, pages and tables are imported only when a method needs them.
    """

    def __repr__(self) -> str:
        """Describe the run in at most six lines."""
        name = f"run '{self.name}'" if self.name else "run"
        plant = list_experiment_parts(self).get("plant", "")
        where = f"plant {plant}" if plant else "unknown plant"
        stored = len(self.control_record.images)
        rows = [
            (name, self.outcome or "no outcome"), ("verdict", describe_verdict(self.verdict)),
            ("reason", self.reason), ("remedy", self.remedy),
            ("duration", f"{self.end_stamp - self.start_stamp:.2f} s of simulated time, "
                         f"{len(self.states)} images processed, {stored} stored"),
            ("scheme", f"{self.scheme or 'unknown'} on {where}"),
        ]  # fmt: skip
        return "\n".join(
            f"{'' if i == 0 else '  '}{title}: {' '.join(str(text).split())}"
            for i, (title, text) in enumerate(rows)
            if text and (title not in ("reason", "remedy") or not self.is_success)
        )

    def _repr_html_(self) -> str:
        """Return the card that notebooks show: outcome, last image, error curve and numbers."""
        return import_later(f"{PACKAGE}.web.report.run_card:make_card")(self)

    def plot(
        self, name: str = "feature_errors", path: str | Path | None = None,
        others: Sequence[Any] = (),
    ) -> Figure:  # fmt: skip
        """Draw one figure of the report.

        Args:
            name: 'feature_errors', 'pose_errors', 'features', 'camera_twist', 'image_trajectory',
                'camera_path', 'joint_positions', 'conditioning', 'timing' or 'filmstrip'.
            path: file to which the figure is also written; its suffix, such as .png, .svg or .pdf,
                selects the format.
            others: further runs, which are drawn in the same figure.

        Returns:
            The figure, which notebooks show.

        Raises:
            BenchError: the figure is unknown, the runs have no data for it, or it cannot be
                written.
        """
        write = f"{PACKAGE}.web.report.write"
        runs = [self, *others]
        if path is not None:
            return import_later(f"{write}:save_figure")(runs, name, path)
        return import_later(f"{write}:draw_figure")(runs, name)

    def report(self, path: str | Path, others: Sequence[Any] = (), **settings: Any) -> Path:
        """Write the report of the run into a folder, as `write_report` does.

        Args:
            path: folder, created if necessary.
            others: further runs, which are compared with this one.
            settings: further arguments of `write_report`, such as kinds=("pdf",).

        Returns:
            The path of the report's page.
        """
        write_report = import_later(f"{PACKAGE}.web.report.write:write_report")
        return write_report([self, *others], Path(path), **settings)[0]

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with one row per processed image.

        Its columns are those of the report's `images.csv`: time, features, desired features,
        errors, twists, condition numbers, camera position, phase, outcome and reason.
        `attrs["units"]` has the unit of each column that has one; lengths are in m, angles in rad,
        times in s.

        Raises:
            BenchError: pandas is not installed.
        """
        return import_later(f"{PACKAGE}.metrics.run_tables:make_frame")(self)


def list_experiment_parts(run: Any) -> dict[str, str]:
    """Return the names of the scheme, the plant and the target of a run, as far as known."""
    experiment = run.experiment
    shape = experiment.target.shape if experiment else ""
    found = {
        "scheme": run.scheme,
        "plant": run.settings.get("plant", "") or (experiment.plant if experiment else ""),
        "target": run.settings.get("target", "") or (shape if isinstance(shape, str) else ""),
    }
    return {part: name for part, name in found.items() if name}


def describe_experiment(run: Any) -> str:
    """Describe scheme, plant and target of a run; '' if none of them is known."""
    return ", ".join(name if part == "scheme" else f"{part} {name}"
                     for part, name in list_experiment_parts(run).items())  # fmt: skip


def describe_verdict(verdict: Any) -> str:
    """Return as text whether the camera has reached its goal, with its distance and angle."""
    if not verdict.name:
        return "unknown, because the true poses are unknown"
    if not math.isfinite(verdict.distance):
        return f"{verdict.name}, distance unknown"
    return (f"{verdict.name}, {1e3 * verdict.distance:.3g} mm and "
            f"{math.degrees(verdict.angle):.3g}° from the goal")  # fmt: skip
