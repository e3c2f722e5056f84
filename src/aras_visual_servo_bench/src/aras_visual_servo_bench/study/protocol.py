"""Published protocols as study files: each runs by its name and leaves a table.

    rosrun aras_visual_servo_bench protocol NAME --out DIR     (or python3 -m ...bench.protocol)

A file says where the protocol comes from, which of its ambiguities was chosen, a base experiment,
the cases (changes to it, and what is published of them), the starts, and how many seeds. What is
computed here is the list of experiments alone; every one is run by the runner, and is a row.

Runs are kept as they come, a file for each block of one case, condition and start, named by what
it was computed from: what is interrupted goes on by the same command, and after a change of the
protocol only what is touched by it is run again.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.settings import build, check, parameter
from aras_visual_servo_base.yaml_files import read_yaml

from ..asked.experiment import Experiment
from ..asked.packages import PackagePath
from ..asked.protocol_starts import Placing, placed
from ..errors import ExperimentError, require
from ..numbers import metrics
from ..running.loop import run
from . import versions

FOLDER = "package://aras_visual_servo_bench/package.xml"
TABLE, BLOCKS, CODE = "table.csv", "blocks", "code.json"
BLOCK = 25  # seeds that are run, and kept, together
WITHIN = 0.01  # of a published number
COLUMNS = {
    "iterations": "iterations", "largest_depth": "largest_depth", "distance": "final_distance",
    "angle": "final_angle", "settled": "settled", "path": "path_length",
    "path_ratio": "path_ratio", "excursion": "image_excursion",
    "start_distance": "start_distance", "reduced": "reduced", "start_angle": "start_angle",
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One row of a protocol's own table: changes to the base experiment.

    set: keys of the experiment. starts: its own, instead of the protocol's.
    published: metric to what is published of it: a word, a whole number (to be met exactly), any
        other number (within 1 %), or [least, greatest]. A start may have its own.
    elsewhere: by condition, what others have published of the like, to be told beside ours.
    """

    name: str
    set: Mapping[str, Any] = field(default_factory=dict)
    starts: tuple[Placing, ...] = ()
    published: Mapping[str, Any] = field(default_factory=dict)
    elsewhere: Mapping[str, str] = field(default_factory=dict)


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
    seeds: int = parameter(1, least=1)
    first_seed: int = parameter(0, least=0)

    def __post_init__(self) -> None:
        check(self, ExperimentError)
        require(len(self.cases) >= 1, "cases: at least one is needed")

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
        return build(cls, read_yaml(path, ExperimentError) or {}, "", ExperimentError)

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
        result = run(experiment)
        row.update(outcome=result.outcome, verdict=result.verdict.word)
        row.update((column, metrics.find(name).measure(result)) for column, name in COLUMNS.items())
        row.update(iterations=int(row["iterations"]), reduced=row["reduced"] == 1.0)
        row.update(angle=math.degrees(row["angle"]))
        row.update(reason=result.reason)
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


@dataclass(frozen=True)
class Block:
    """Up to BLOCK seeds of one case, condition and start. name: of what it is computed from."""

    runs: tuple[Planned, ...]

    @property
    def name(self) -> str:
        """The same for the same rows, whatever else the protocol holds."""
        return hashlib.sha256(repr(self.runs).encode()).hexdigest()[:20]

    @property
    def title(self) -> str:
        """For people."""
        row = self.runs[0][0]
        return f"{row['case']}, {row['condition']}, {row['start']}"

    def rows(self) -> list[dict[str, Any]]:
        """Every run carried out."""
        return [row_of(*planned) for planned in self.runs]


def blocks(protocol: Protocol) -> list[Block]:
    """All runs of a protocol in blocks, in order; ExperimentError as `Protocol.runs`."""
    found: dict[tuple[object, ...], list[Planned]] = {}
    for planned in protocol.runs():
        row = planned[0]
        key = row["case"], row["condition"], row["start"], row["seed"] // BLOCK
        found.setdefault(key, []).append(planned)
    return [Block(tuple(runs)) for runs in found.values()]


class Kept:
    """A protocol's folder: blocks that are done, and the table of them all."""

    def __init__(self, folder: Path, mix: bool = False) -> None:
        """Open or make it.

        Args:
            mix: it may have been begun with other code.

        Raises:
            ExperimentError: it was begun with other code.
        """
        self.folder = folder
        (folder / BLOCKS).mkdir(parents=True, exist_ok=True)
        now, path = versions.versions(), folder / CODE
        if path.exists() and not mix:
            told = versions.difference(now, json.loads(path.read_text(encoding="utf-8")))
            require(
                not told,
                f"{folder} was begun with other code ({told}): name a new folder, or say --mix",
            )
        path.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")

    def path(self, block: Block) -> Path:
        """Where a block's rows are."""
        return self.folder / BLOCKS / f"{block.name}.json"

    def read(self, block: Block) -> list[dict[str, Any]] | None:
        """Rows of a block, None where it is not done."""
        try:
            return json.loads(self.path(block).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return None

    def write(self, block: Block, rows: list[dict[str, Any]]) -> None:
        """Keep a block's rows, whole or not at all."""
        new = self.path(block).with_suffix(".new")
        new.write_text(json.dumps(rows), encoding="utf-8")
        new.replace(self.path(block))

    def tabulate(self, wanted: Sequence[Block]) -> int:
        """Write the table of those blocks that are done; answers how many runs it has."""
        done = (self.read(block) for block in wanted)
        rows = [row for found in done if found is not None for row in found]
        write_table(self.folder / TABLE, rows)
        return len(rows)


def carry_out(missing: Sequence[Block], workers: int = 1) -> Iterator[tuple[Block, list]]:
    """Blocks with their rows, as they are done; with `workers` processes the same rows."""
    if workers <= 1:
        yield from ((block, block.rows()) for block in missing)
        return
    # Begun anew, not forked: a fork of a process with threads may wait for ever for a lock.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            under_way = {pool.submit(block.rows): block for block in missing}
            for done in as_completed(under_way):
                yield under_way[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)


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
    parser.add_argument("--condition", action="append", help="only these conditions")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--mix", action="store_true", help="go on although the code has changed")
    options = parser.parse_args(argv)
    changes = {
        "seeds": options.seeds, "first_seed": options.first, "cases": options.case,
        "conditions": options.condition,
    }  # fmt: skip
    try:
        whole = _chosen(Protocol.load(options.name), {**changes, "cases": None, "conditions": None})
        every = blocks(whole)
        wanted = blocks(_chosen(whole, changes))
        kept = Kept(options.out, options.mix)
        missing = [block for block in wanted if kept.read(block) is None]
        try:
            for block, rows in carry_out(missing, options.workers):
                kept.write(block, rows)
                print(f"{block.title}: {_told(rows)}", flush=True)
        except KeyboardInterrupt:
            print("protocol: interrupted; the same command goes on", file=sys.stderr)
            return 130
        finally:
            count = kept.tabulate(every)
    except (ExperimentError, OSError) as error:
        print(f"protocol: {error}", file=sys.stderr)
        return 1
    print(f"wrote {options.out / TABLE}: {count} runs")
    return 0


def _told(rows: Sequence[Mapping[str, Any]]) -> str:
    """A block in a line."""
    if len(rows) == 1:
        return " ".join(f"{k}={v}" for k, v in list(rows[0].items())[4:] if k != "reason")
    reached = sum(row.get("verdict") == "goal_reached" for row in rows)
    outcomes = Counter(str(row.get("outcome")) for row in rows).most_common()
    told = ", ".join(f"{word} {count}" for word, count in outcomes)
    return f"{reached} of {len(rows)} at the goal; {told}"


def _chosen(protocol: Protocol, changes: Mapping[str, Any]) -> Protocol:
    """The protocol with what the command line says; ExperimentError: a name that it has not."""
    here = {name: getattr(protocol, name) for name in protocol.__dataclass_fields__}
    given = {key: value for key, value in changes.items() if value is not None}
    for key in ("cases", "conditions"):
        if key in given:
            known = {one.name: one for one in here[key]}
            for name in given[key]:
                require(name in known, f"{key[:-1]} '{name}': {nearest(name, known)}")
            given[key] = tuple(known[name] for name in given[key])
    return Protocol(**{**here, **given})


if __name__ == "__main__":
    sys.exit(main())
