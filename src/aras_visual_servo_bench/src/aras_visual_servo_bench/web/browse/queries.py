"""Queries of the results browser, which are built from the fields of the page's requests."""

from __future__ import annotations

from dataclasses import dataclass

from aras_visual_servo_base.settings import parameter

from ...metrics.metrics import success

OPERATORS = ("=", "≠", "<", "≤", ">", "≥", "contains", "is known", "is not known")
MAX_ROWS = 200  # largest number of rows in the answer to one query of the page


@dataclass(frozen=True)
class ColumnFilter:
    """A condition on the values of a column.

    Attributes:
        value: number, text, or True or False, depending on the type of the column.
    """

    column: str
    operator: str = parameter("=", choices=OPERATORS)
    value: float | str | bool | None = None


@dataclass(frozen=True)
class RunSelection:
    """Selection of the runs that satisfy all filters.

    Attributes:
        studies: names of the studies; empty for all studies.
    """

    studies: tuple[str, ...] = ()
    filters: tuple[ColumnFilter, ...] = ()


@dataclass(frozen=True)
class RowQuery(RunSelection):
    """Query of `count` runs, sorted by a column, starting at the index `first`."""

    sort: str = ""
    descending: bool = False
    first: int = parameter(0, least=0)
    count: int = parameter(50, least=1, most=MAX_ROWS)


@dataclass(frozen=True)
class GroupQuery(RunSelection):
    """Query of groups of runs.

    Attributes:
        by: columns that define the groups; each combination of their values is a group.
        values: columns to summarize in each group: by the median, or for a binary metric by the
            rate.
    """

    by: tuple[str, ...] = ()
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class MapQuery(RunSelection):
    """Query of a map whose axes are two columns.

    Attributes:
        value: column to summarize in each cell: by the median, or for a binary metric by the rate.
    """

    x: str = ""
    y: str = ""
    value: str = success.name


@dataclass(frozen=True)
class PointQuery(RunSelection):
    """Query of a scatter plot with a point for each run.

    Attributes:
        colour_by: column that determines the colours of the points; '' for none.
    """

    x: str = ""
    y: str = ""
    colour_by: str = ""


@dataclass(frozen=True)
class RunQuery:
    """Query of one run of a study."""

    study: str
    run: int = parameter(least=0)


@dataclass(frozen=True)
class ComparisonQuery:
    """Query of the differences of two studies.

    Attributes:
        by: columns that define the groups; empty for the settings that both studies have.
    """

    first: str
    second: str
    by: tuple[str, ...] = ()


@dataclass(frozen=True)
class StudiesQuery:
    """Query of the list of studies.

    Attributes:
        force: whether to read the folders even if they were read less than a second ago.
    """

    force: bool = False
