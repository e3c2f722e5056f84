"""Captions of the figures of studies."""

from __future__ import annotations

from collections.abc import Sequence

from ..metrics.metric import Metric
from ..metrics.metrics import final_distance
from ..studies import captions
from ..studies.results import Results
from .run_groups import (
    find_distance_tolerance,
    find_pooled_keys,
    find_varied_keys,
    has_final_distance,
)
from .success_figures import find_curve_keys


def make_caption(
    name: str, all_results: Sequence[Results], shown: Sequence[Metric]
) -> list[str]:
    """Return the sentences of the caption of a figure.

    name: name of the figure, such as 'boxes', or with a metric, such as 'boxes_path_length'.
    """
    kind = name.partition("_")[0]
    names = ", ".join(m.name.replace("_", " ") for m in shown)
    lines = {
        "success": _describe_success_figure,
        "rates": lambda _: [f"Rates of {names}, with Wilson's 95 % interval."],
        "distributions": lambda _: [f"Cumulative distribution of {names}. Curves of groups in "
                                    "which some runs have no value end below 100 %."],
        "boxes": lambda _: [f"Quartiles of {names}. Whiskers end at the last value within 1.5 "
                            "interquartile ranges; dots are values beyond them."],
        "sensitivity": lambda _: ["Spearman's rank correlation of metrics and settings."],
        "trajectories": lambda _: ["Norm of the errors relative to the first image, and paths of "
                                   "the camera in two views."],
    }[kind](all_results)  # fmt: skip
    lines += captions.describe_success(all_results, shown)
    has_distance = final_distance in shown or kind == "success" and has_final_distance(all_results)
    if has_distance and find_distance_tolerance(all_results) is not None:
        lines.append("Dotted line: tolerance of the distance.")
    if kind in ("success", "rates", "distributions", "boxes"):
        pooled = find_pooled_keys(kind, all_results)
        lines += [f"Runs with different {', '.join(pooled)} are pooled."] if pooled else []
    if kind in ("rates", "distributions", "boxes"):
        keys = [key for key in find_varied_keys(all_results) if key not in pooled]
        lines += captions.describe_missing(shown, all_results, keys)
    return [*lines, *captions.describe_repeats(all_results)]


def _describe_success_figure(all_results: Sequence[Results]) -> list[str]:
    keys = find_varied_keys(all_results)
    is_map = len(keys) > 1
    rates = "successful runs of all runs" if is_map else "success rates with Wilson's 95 % interval"
    if not has_final_distance(all_results):
        return [f"{rates[0].upper()}{rates[1:]}."]
    lines = [f"{rates[0].upper()}{rates[1:]}, and distribution of the final distance."]
    if is_map:
        pooled = [key for key in keys if key not in find_curve_keys(all_results)]
        lines.append(f"The curves pool runs with different {', '.join(pooled)}.")
    return lines


def format_caption(file: str, lines: Sequence[str]) -> str:
    """Return the caption of a file as Markdown."""
    return f"**{file}**: {' '.join(lines)}\n"
