"""Names of the columns of the results. This module imports no library."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import StudyError

# columns that the results of all studies have, with their Arrow types
FIXED_COLUMNS = {
    "run": "int64", "point": "int64", "repeat": "int64", "seed": "int64",
    "outcome": "string", "verdict": "string", "reason": "string", "remedy": "string",
    "images": "int64", "simulated": "double",
    # largest distance (m) and angle (rad) from the goal at which it counts as reached
    "distance_tolerance": "double", "angle_tolerance": "double",
}  # fmt: skip
LABEL_COLUMNS = ("code", "versions")  # columns with the same value in all rows of a study


def find_column_name(metric: str) -> str:
    """Return the column name of a metric that is given as name or 'package.module:function'."""
    return metric.rpartition(":")[2]


def check_columns(keys: Sequence[str], metrics: Sequence[str]) -> None:
    """Check that no two columns of the results of a study have the same name.

    Args:
        keys: keys that the study varies, and names of its axes of cases.
        metrics: names of metrics, or 'package.module:function'.

    Raises:
        StudyError: two columns would have the same name.
    """
    common = {*FIXED_COLUMNS, *LABEL_COLUMNS}
    for key in keys:
        if key in common and key != "seed":
            raise StudyError(
                f"'{key}' is a column of all results: give the axis of cases another name"
            )
    taken: set[str] = set()
    for name in map(find_column_name, metrics):
        if name in keys:
            raise StudyError(
                f"'{name}' is both a varied key and a metric, which would share one column: "
                "leave the metric out, or vary the key in a named axis of cases"
            )
        if name in common:
            raise StudyError(
                f"metric '{name}' has the name of a column of all results: leave the metric out, "
                "or rename it if it is your own"
            )
        if name in taken:
            raise StudyError(
                f"two metrics are named '{name}': remove one of them, or rename its function"
            )
        taken.add(name)
