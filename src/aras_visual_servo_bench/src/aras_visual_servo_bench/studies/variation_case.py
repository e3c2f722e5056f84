"""Cases of a study: sets of settings on named axes, and the combinations of these axes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import convert, parameter

from ..errors import StudyError


@dataclass(frozen=True)
class VariationCase:
    """Case of a named axis, that is, one of the sets of settings that the axis contains.

    name: name of the case.
    set: settings of the case: values by dotted key of the experiment.
    published: published values, by the name of a metric, 'outcome' or 'verdict'. A text or a whole
        number must agree exactly, another number within 1 %; [minimum, maximum] is a range.
    elsewhere: results that other publications report for similar cases, as text, by the names of
        the cases of the other axes; for information only.
    cases: axes of cases; in combinations with this case, they replace the study's axes of the same
        names.
    """

    name: str = parameter(name=True)
    set: Mapping[str, Any] = parameter({})
    published: Mapping[str, Any] = parameter({})
    elsewhere: Mapping[str, Any] = parameter({})
    cases: Mapping[str, Any] = parameter({})


@dataclass(frozen=True)
class Combination:
    """Combination of one case of each axis.

    names: name of the chosen case, by the name of its axis.
    set: settings of all these cases, by dotted key.
    published: values that publications report for these cases, by the name of the column.
    """

    names: Mapping[str, str]
    set: Mapping[str, Any]
    published: Mapping[str, Any]


def parse_axes(cases: Mapping[str, Any]) -> dict[str, tuple[VariationCase, ...]]:
    """Parse named axes of cases.

    Raises:
        StudyError: an axis has no case, or two cases with the same name.
    """
    axes = {}
    for axis, value in cases.items():
        parsed = axes[str(axis)] = convert(
            value, tuple[VariationCase, ...], f"cases.{axis}", StudyError
        )
        names = [case.name for case in parsed]
        duplicates = [name for name in names if names.count(name) > 1]
        if not names or duplicates:
            problem = f"two cases are named '{duplicates[0]}'" if duplicates else "it has no case"
            raise StudyError(f"cases.{axis}: {problem}")
    return axes


def combine_axes(axes: Mapping[str, tuple[VariationCase, ...]]) -> Iterator[Combination]:
    """Yield all combinations of cases; a case can replace the axes after its own by its `cases`."""
    if not axes:
        yield Combination({}, {}, {})
        return
    axis, *rest = axes
    for case in axes[axis]:
        own = parse_axes(case.cases)
        for key in own:
            if key not in rest:
                raise StudyError(f"cases.{axis}.{case.name}.cases: {suggest(key, rest)}")
        for others in combine_axes({key: own.get(key, axes[key]) for key in rest}):
            yield Combination(
                {axis: case.name, **others.names}, {**case.set, **others.set},
                {**case.published, **others.published},
            )  # fmt: skip
