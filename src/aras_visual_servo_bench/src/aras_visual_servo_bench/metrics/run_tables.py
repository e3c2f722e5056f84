"""Tables of a run: one row per processed image, and one row per joint state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import make_missing_library_error
from ..recording.run import Run
from .condition_number import compute_condition_numbers

if TYPE_CHECKING:
    import pandas

TWIST_AXES = ("vx", "vy", "vz", "wx", "wy", "wz")


class TableColumn(NamedTuple):
    """Column of a table: its values (n,), numbers or texts, and its unit; '' for none."""

    values: np.ndarray
    unit: str = ""


def make_image_columns(run: Run) -> dict[str, TableColumn]:
    """Return the columns of the table with one row per processed image, by name."""
    columns = {"time": TableColumn(run.time, "s"), "stamp": TableColumn(run.stamp, "s")}
    for i, (name, unit) in enumerate(zip(run.names, run.units, strict=True)):
        columns[name] = TableColumn(run.features[:, i], unit)
        columns[f"{name} desired"] = TableColumn(run.desired_features[:, i], unit)
        columns[f"{name} error"] = TableColumn(run.error[:, i], unit)
        columns[f"{name} filtered error"] = TableColumn(run.filtered_error[:, i], unit)
    for word, twist in (("desired", run.desired_twist), ("achieved", run.achieved_twist)):
        for i, axis in enumerate(TWIST_AXES):
            columns[f"{axis} {word}"] = TableColumn(twist[:, i], "m/s" if i < 3 else "rad/s")
    columns |= {
        "condition of L": TableColumn(compute_condition_numbers(run.singular_L)),
        "condition of L J": TableColumn(compute_condition_numbers(run.singular_LJ)),
        "manipulability": TableColumn(run.manipulability), "scale": TableColumn(run.scale),
        "computing": TableColumn(run.computation_time, "s"),
        **_make_position_columns(run.pose),
    }  # fmt: skip
    for name, texts in (
        ("phase", run.phases), ("outcome", run.outcomes), ("reason", run.reasons)
    ):  # fmt: skip
        columns[name] = TableColumn(np.array(texts, object))
    return columns


def make_joint_columns(run: Run) -> dict[str, TableColumn]:
    """Return the columns of the table with one row per joint state, by name."""
    columns = {"time": TableColumn(run.joint_time, "s"), "stamp": TableColumn(run.joint_stamp, "s")}
    units = dict(zip(run.joint_names, run.joint_units, strict=False))
    for i, name in enumerate(run.joint_names):
        unit = units.get(name, "rad")
        columns[name] = TableColumn(run.measured_positions[:, i], unit)
        columns[f"{name} speed"] = TableColumn(run.measured_velocities[:, i], f"{unit}/s")
        columns[f"{name} command"] = TableColumn(run.joint_commands[:, i], unit)
    return columns | _make_position_columns(run.true_pose)


def _make_position_columns(poses: np.ndarray) -> dict[str, TableColumn]:
    """Return columns with the camera position x, y, z of each of the poses (n, 4, 4)."""
    return {f"camera {axis}": TableColumn(poses[:, i, 3], "m") for i, axis in enumerate("xyz")}


def make_frame(run: Run) -> pandas.DataFrame:
    """Return the table with one row per processed image; see `Run.to_pandas`."""
    columns = make_image_columns(run)
    frame = import_pandas().DataFrame({name: column.values for name, column in columns.items()})
    frame.index.name = "image"
    frame.attrs["units"] = {name: column.unit for name, column in columns.items() if column.unit}
    return frame


def import_pandas() -> Any:
    """Import pandas, which takes 0.5 s and is therefore done only for a table.

    Raises:
        BenchError: pandas is not installed.
    """
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise make_missing_library_error(error.name, "pandas") from None
    return pandas
