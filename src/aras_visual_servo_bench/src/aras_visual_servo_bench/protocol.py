"""Published protocols as study files: each runs by its name and leaves a table.

    rosrun aras_visual_servo_bench protocol NAME --out DIR     (or python3 -m ...bench.protocol)

A file says where the protocol comes from, which of its ambiguities was chosen, a base experiment,
the cases (changes to it, and what is published of them), the starts, and how many seeds. What is
computed here is the list of experiments alone; every one is run by the runner, and is a row.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from .checked import build, nearest, read_yaml, require
from .errors import ExperimentError
from .experiment import Experiment
from .measures import measures
from .packages import PackagePath
from .protocol_starts import START_KINDS, Placing, placed
from .runner import run

FOLDER = "package://aras_visual_servo_bench/package.xml"
TABLE = "table.csv"
CHUNK = 8  # runs that a worker is handed at once
WITHIN = 0.01  # of a published number


@dataclass(frozen=True)
class Case:
    """One row of a protocol's own table: changes to the base experiment.

    set: keys of the experiment. starts: its own, instead of the protocol's.
    published: metric to what is published of it: a word, a whole number (to be met exactly), any
        other number (within 1 %), or [least, greatest]. A start may have its own.
    """

    name: str
    set: Mapping[str, Any] = field(default_factory=dict)
    starts: tuple[Placing, ...] = ()
    published: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Protocol:
    """A study file; see the head of the module.

    source: where it is published. chosen: what was chosen where that is ambiguous.
    experiment: the base. cases, conditions: each case is run under each condition.
    starts: see Placing; none: the experiment's own. seeds: how many of each.
    """

    source: str
    experiment: Mapping[str, Any]
    chosen: tuple[str, ...] = ()
    cases: tuple[Case, ...] = (Case("base"),)
    conditions: tuple[Case, ...] = (Case("clean"),)
    starts: tuple[Placing, ...] = (Placing("given"),)
    seeds: int = 1
    first_seed: int = 0

    def __post_init__(self) -> None:
        require(self.seeds >= 1, "seeds must be 1 or more")
        require(len(self.cases) >= 1, "cases: at least one is needed")
        for start in (*self.starts, *(start for case in self.cases for start in case.starts)):
            require(start.kind in START_KINDS, f"starts: {nearest(start.kind, START_KINDS)}")

    @classmethod
    def load(cls, name: str) -> Protocol:
        """A protocol that ships, by name, or a file by its path.

        Raises:
            ExperimentError: there is none, or a key of it is wrong.
        """
        path = Path(name)
        if not name.endswith((".yaml", ".yml")):
            folder = PackagePath(()).file(FOLDER).parent / "protocols"
            known = sorted(file.stem for file in folder.glob("*.yaml"))
            require(name in known, f"protocol '{name}' is none: {nearest(name, known)}")
            path = folder / f"{name}.yaml"
        return build(cls, read_yaml(path) or {})

    def runs(self) -> Iterator[Planned]:
        """Every run: what its row begins with, its experiment, and what is published of it.

        Raises:
            ExperimentError: a case that cannot be run as it is written.
        """
        for case in self.cases:
            for condition in self.conditions:
                changed = merged(merged(self.experiment, case.set), condition.set)
                base = Experiment.from_mapping(changed)
                for start in case.starts or self.starts:
                    for seed in range(self.first_seed, self.first_seed + self.seeds):
                        row = {
                            "case": case.name, "condition": condition.name,
                            "start": start.name or start.kind, "seed": seed,
                        }  # fmt: skip
                        published = {**case.published, **start.published}
                        yield row, placed(replace(base, seed=seed), start, seed), published


Planned = tuple[dict[str, Any], Experiment, Mapping[str, Any]]


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping with changes; mappings in it are merged too, unless they are the start or goal."""
    result = dict(base)
    for key, value in changes.items():
        mergeable = key in ("options", "believed", "ideal", "camera", "law_options", "target")
        if mergeable and isinstance(value, Mapping) and isinstance(result.get(key), Mapping):
            value = merged(result[key], value)
        result[key] = value
    return result


def row_of(
    known: Mapping[str, Any], experiment: Experiment, published: Mapping[str, Any]
) -> dict[str, Any]:
    """One run as a line of plain values; what cannot be run is an outcome as well."""
    row = dict(known)
    try:
        row.update(measures(experiment, run(experiment)))
    except ExperimentError as error:
        row.update(outcome="not_run", reason=str(error))
    for metric, wanted in published.items():
        row[f"published_{metric}"] = wanted
    if published:
        row["met"] = all(met(row.get(metric), wanted) for metric, wanted in published.items())
    return row


def met(value: Any, published: Any) -> bool:
    """Whether a value is as published; see Case."""
    if value is None or isinstance(value, str) or isinstance(published, str):
        return value == published
    if isinstance(published, list | tuple):
        return published[0] <= value <= published[1]
    if isinstance(published, int):
        return value == published
    return abs(value - published) <= WITHIN * abs(published)


def _row(planned: Planned) -> dict[str, Any]:
    return row_of(*planned)


def study(protocol: Protocol, workers: int = 1) -> Iterator[dict[str, Any]]:
    """Rows in order; with `workers` processes the same rows."""
    runs = list(protocol.runs())
    if workers <= 1:
        yield from map(_row, runs)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(_row, runs, chunksize=CHUNK)


def write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    """CSV with a column for every key, in the order in which they come up first."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def main(argv: list[str] | None = None) -> int:
    """Run a protocol; returns the exit status."""
    parser = argparse.ArgumentParser(prog="protocol", description=__doc__.splitlines()[0])
    parser.add_argument("name", help="of a protocol that ships, or a file")
    parser.add_argument("--out", type=Path, required=True, help="folder for table.csv")
    parser.add_argument("--seeds", type=int, help="fewer or more than the file says")
    parser.add_argument("--first", type=int, help="first seed")
    parser.add_argument("--case", action="append", help="only these cases")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args(argv)
    try:
        protocol = Protocol.load(options.name)
        changes = {
            "seeds": options.seeds, "first_seed": options.first, "cases": options.case,
        }  # fmt: skip
        protocol = _chosen(protocol, {k: v for k, v in changes.items() if v is not None})
        options.out.mkdir(parents=True, exist_ok=True)
        rows = []
        for row in study(protocol, options.workers):
            rows.append(row)
            print(" ".join(f"{key}={value}" for key, value in row.items() if key != "reason"),
                  flush=True)  # fmt: skip
        write_table(options.out / TABLE, rows)
    except (ExperimentError, OSError) as error:
        print(f"protocol: {error}", file=sys.stderr)
        return 1
    print(f"wrote {options.out / TABLE}: {len(rows)} runs")
    return 0


def _chosen(protocol: Protocol, changes: dict[str, Any]) -> Protocol:
    """The protocol with what the command line says."""
    here = {name: getattr(protocol, name) for name in protocol.__dataclass_fields__}
    if "cases" in changes:
        known = {case.name: case for case in protocol.cases}
        for name in changes["cases"]:
            require(name in known, f"case '{name}': {nearest(name, known)}")
        changes = {**changes, "cases": tuple(known[name] for name in changes["cases"])}
    return Protocol(**{**here, **changes})


if __name__ == "__main__":
    sys.exit(main())
