"""A study is data too: a base experiment, what is varied of it, how often, and the seed.

Its runs are numbered from 0; each depends on its number alone, on whatever machine it is run.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import KeywordSettings, build, check, convert, parameter
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import ExperimentError, StudyError
from ..experiment.experiment import Experiment
from ..experiment.experiment_keys import check_key
from ..experiment.overrides import with_override, with_overrides
from ..metrics import metrics as known_metrics
from .variations import Axis, RandomVariation, draw_values, parse_variation

MAX_RUNS = 100_000_000  # 1e6 chunks of 100 runs: beyond that a scheduler chokes
MAX_CHUNK = 10_000
IMAGE_CHUNK = 4  # runs whose pictures a worker holds in its memory
IMAGE_CHOICES = ("none", "first", "all")
SAMPLINGS, SEEDS = ("random", "sobol"), ("runs", "repeats", "counted")
# words about a study, which change nothing of its runs
DESCRIPTIVE_KEYS = ("source", "chosen", "judged")


@dataclass(frozen=True)
class Case:
    """One value of a named axis of cases.

    set: dotted keys of the experiment.
    published: metric, outcome or verdict, to what is published of it: a word, a whole number (to
        be met exactly), any other number (within 1 %), or [least, greatest].
    elsewhere: by the name of another axis' case, what others have published of the like.
    cases: axes in place of the study's of that name, of this case alone.
    """

    name: str = parameter(name=True)
    set: Mapping[str, Any] = parameter({})
    published: Mapping[str, Any] = parameter({})
    elsewhere: Mapping[str, Any] = parameter({})
    cases: Mapping[str, Any] = parameter({})


@dataclass(frozen=True)
class Combination:
    """Cases that are run together. names: by axis. set: dotted keys. published: by column."""

    names: Mapping[str, str]
    set: Mapping[str, Any]
    published: Mapping[str, Any]


@dataclass(frozen=True)
class Study(KeywordSettings):
    """Many runs as data: a base experiment, what varies, how often, and the seed.

    `run_study(study, folder)` carries out its runs, on all cores, and returns their `Results`.
    Interrupted or not, on one machine or several, the results are bit-identical. A wrong key or
    value raises a StudyError before the first run.

    experiment: keys of the base experiment, the Experiment itself, or the path of its YAML file.
    vary: by dotted key, what it takes in turn or is drawn from; see variations.py.
    source: where it is published. chosen: what was chosen where that is ambiguous.
    cases: sets of keys with values that belong together, in turn; each with all that is varied.
        Or named axes, each a list of Case: their product, the last axis runs fastest.
    samples: how often what has a distribution is drawn. sampling: 'random' or 'sobol'.
    repeats: runs of each point. seed: of all that is random.
    seeds: 'runs': every run has its own; 'repeats': repeat n of every point has the same, so that
        points are compared over the same starts and the same noise; 'counted': repeat n of every
        point has the seed `seed` + n.
    metrics: names, or 'package.module:function'; empty: all that are built in.
    judged: the metric whose 1 is a success, in what is told of the study.
    chunk: runs that are one task and one file; None: by the number of runs.
    traces: keep features, twists, joints and poses of every image.
    pictures: keep besides what every camera saw: 'all', or the 'first' image of each run alone,
        which ends with it; see images.py. depth: keep their depth images too.
    limit: of a run's wall time, s; one that takes longer has the outcome 'time_limit'.
    """

    fault = StudyError

    experiment: Mapping[str, Any] | str = parameter({})
    vary: Mapping[str, Any] = parameter({})
    cases: tuple[Mapping[str, Any], ...] | Mapping[str, Any] = ()
    samples: int = parameter(1, least=1)
    sampling: str = parameter("random", choices=SAMPLINGS)
    repeats: int = parameter(1, least=1)
    seed: int = parameter(0, least=0)
    seeds: str = parameter("runs", choices=SEEDS)
    metrics: tuple[str, ...] = ()
    judged: str = known_metrics.success.name
    chunk: int | None = parameter(None, "runs", least=1, most=MAX_CHUNK)
    traces: bool = False
    pictures: str = parameter("none", choices=IMAGE_CHOICES)
    depth: bool = False
    limit: float = parameter(900.0, "s", above=0.0)
    source: str = ""
    chosen: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check(self, StudyError)
        if isinstance(self.experiment, str):
            given = read_yaml(self.experiment, StudyError, "the experiment") or {}
            if not isinstance(given, Mapping):
                raise StudyError(f"{self.experiment} holds no keys with values")
            object.__setattr__(self, "experiment", given)
        if "seed" in self.experiment:
            raise StudyError("seed belongs to the study, not to its experiment: every run has one")
        for key in self.keys:
            if key not in self.case_axes:
                check_key(key)
        for combination in self.combinations:
            for key in combination.set:
                check_key(key)
        if self.samples > 1 and not self.random_variations:
            raise StudyError(
                f"samples is {self.samples}, but nothing is drawn: say repeats, or give a key "
                "under vary a distribution"
            )
        if self.run_count > MAX_RUNS:
            raise StudyError(
                f"{self.run_count:.3g} runs are more than {MAX_RUNS:g}: make the grid, samples or "
                "repeats smaller"
            )
        # Said before the first run, not by a worker an hour later.
        for name in self.metric_names:
            try:
                known_metrics.find_metric(name)
            except StudyError as error:
                raise StudyError(f"metrics: {error}") from None
        if self.judged not in (known_metrics.success.name, *self.metric_names):
            raise StudyError(f"judged is '{self.judged}', which is not among the study's metrics: "
                             f"{suggest(self.judged, self.metric_names)}")  # fmt: skip

    # -- reading ---------------------------------------------------------------------------

    @classmethod
    def from_mapping(cls, values: Any) -> Study:
        """A study of the keys that are given; StudyError naming what is wrong."""
        return build(cls, values, "", StudyError)

    @classmethod
    def from_yaml(cls, path: str | Path, overrides: Mapping[str, Any] | None = None) -> Study:
        """A study of a YAML file.

        Args:
            overrides: dotted keys of the study itself (`repeats`), or else of its experiment
                (`gain`, `start.side`); these no longer vary.

        Raises:
            StudyError: naming what is wrong.
        """
        values = read_yaml(path, StudyError)
        if not isinstance(values, Mapping):
            raise StudyError(f"{path} holds no keys with values: it is no study")
        values = dict(values)
        base = values.get("experiment")
        if isinstance(base, str):  # beside the study
            beside = Path(path).parent / base
            found = read_yaml(beside if beside.is_file() else base, StudyError)
            values["experiment"] = found or {}
        return cls.from_mapping(_apply_overrides(values, overrides or {}))

    def to_mapping(self) -> dict[str, Any]:
        """Plain values from which `from_mapping` makes the same study."""
        return json.loads(json.dumps({
            f.name: getattr(self, f.name) for f in dataclasses.fields(self)
        }, default=_to_plain))  # fmt: skip

    @cached_property
    def digest(self) -> str:
        """The same for the same study, whatever its file looks like."""
        told = {k: v for k, v in self.to_mapping().items() if k not in DESCRIPTIVE_KEYS}
        text = json.dumps(told, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    # -- runs ------------------------------------------------------------------------------

    @cached_property
    def _variations(self) -> tuple[Axis | RandomVariation, ...]:
        return tuple(parse_variation(str(key), given) for key, given in self.vary.items())

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """What makes the grid."""
        return tuple(v for v in self._variations if isinstance(v, Axis))

    @cached_property
    def random_variations(self) -> tuple[RandomVariation, ...]:
        """What is drawn."""
        return tuple(v for v in self._variations if isinstance(v, RandomVariation))

    @cached_property
    def case_axes(self) -> dict[str, tuple[Case, ...]]:
        """The named axes of cases; none where `cases` is a list of sets."""
        return _parse_axes(self.cases) if isinstance(self.cases, Mapping) else {}

    @cached_property
    def combinations(self) -> tuple[Combination, ...]:
        """Cases that are run together, in order; at least one, which may set nothing."""
        if isinstance(self.cases, Mapping):
            return tuple(_combine_axes(self.case_axes))
        return tuple(Combination({}, case, {}) for case in self.cases) or (Combination({}, {}, {}),)

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Columns of all that differs between runs, in the order of the file.

        Dotted keys of the experiment, or the names of the axes of cases.
        """
        listed = () if self.case_axes else self.cases
        of_cases = (*self.case_axes, *dict.fromkeys(str(key) for case in listed for key in case))
        both = [v.key for v in self._variations if v.key in of_cases]
        if both:
            raise StudyError(f"'{both[0]}' stands both under vary and in cases")
        return (*of_cases, *(v.key for v in self._variations))

    @cached_property
    def metric_names(self) -> tuple[str, ...]:
        """The metrics that each row has."""
        return self.metrics or known_metrics.list_default_metrics()

    @cached_property
    def point_count(self) -> int:
        """How many different settings there are."""
        grid = math.prod(len(axis.values) for axis in self.axes)
        return len(self.combinations) * grid * self.samples

    @property
    def run_count(self) -> int:
        """How many runs there are."""
        return self.point_count * self.repeats

    @property
    def chunk_size(self) -> int:
        """Runs in a chunk: 20 to 100 where there are many, fewer where cores would stand idle or
        pictures fill the memory."""
        most = IMAGE_CHUNK if self.pictures == "all" else 100
        return self.chunk or min(max(math.ceil(self.run_count / 40), 1), most)

    @property
    def has_image_rows(self) -> bool:
        """Whether there is a row for every image, with a picture or without."""
        return self.traces or self.pictures != "none"

    @property
    def chunk_count(self) -> int:
        """How many tasks, and files, there are."""
        return math.ceil(self.run_count / self.chunk_size)

    def list_chunk_runs(self, chunk: int) -> range:
        """Numbers of a chunk's runs."""
        first = chunk * self.chunk_size
        return range(first, min(first + self.chunk_size, self.run_count))

    def find_combination(self, point: int) -> Combination:
        """The cases of the point of that number."""
        return self.combinations[point // (self.point_count // len(self.combinations))]

    def make_settings(self, point: int) -> dict[str, Any]:
        """By column, what the point of that number sets."""
        cases = self.find_combination(point)
        found = {**(cases.names or cases.set), **self._compute_variations(point)}
        return {key: found[key] for key in self.keys if key in found}

    def _compute_variations(self, point: int) -> dict[str, Any]:
        """By dotted key, what is varied at the point of that number."""
        rest, sample = divmod(point, self.samples)
        found: dict[str, Any] = {}
        for axis in reversed(self.axes):
            rest, index = divmod(rest, len(axis.values))
            found[axis.key] = axis.values[index]
        found.update(draw_values(self.random_variations, self.sampling, self.seed, sample))
        return {v.key: found[v.key] for v in self._variations}

    def compute_seed(self, run: int) -> int:
        """The seed of a run, from its number and the study's seed alone."""
        if self.seeds == "counted":
            return self.seed + run % self.repeats
        number = run % self.repeats if self.seeds == "repeats" else run
        sequence = np.random.SeedSequence(self.seed, spawn_key=(number,))
        # Of 63 bits: among 1e5 runs with 32 there would be two that are equal.
        return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))

    def make_experiment(self, run: int) -> Experiment:
        """The experiment of a run; ExperimentError where its values do not go together."""
        point = run // self.repeats
        settings = {**self.find_combination(point).set, **self._compute_variations(point)}
        return self._build_experiment(settings, self.compute_seed(run))

    def _build_experiment(self, settings: Mapping[str, Any], seed: int) -> Experiment:
        values = with_overrides(self.experiment, settings)
        values.setdefault("seed", seed)
        return Experiment.from_mapping(values)

    def make_trials(self) -> list[Experiment]:
        """Experiments that together show every value that is named in the study once.

        Raises:
            StudyError: one of them is no experiment, naming the key.
        """
        varied = self._compute_variations(0)
        first = {**self.combinations[0].set, **varied}
        different: list[dict[str, Any]] = [{**cases.set, **varied} for cases in self.combinations]
        different += [{**first, axis.key: v} for axis in self.axes for v in axis.values[1:]]
        different += [{**first, draw.key: v} for draw in self.random_variations for v in draw.ends]
        try:
            return [
                self._build_experiment(settings, self.compute_seed(0)) for settings in different
            ]
        except ExperimentError as error:
            raise StudyError(str(error)) from error


def _parse_axes(cases: Mapping[str, Any]) -> dict[str, tuple[Case, ...]]:
    """Named axes as they are written; StudyError where one has no case, or two of one name."""
    axes = {}
    for axis, given in cases.items():
        found = axes[str(axis)] = convert(given, tuple[Case, ...], f"cases.{axis}", StudyError)
        names = [case.name for case in found]
        twice = [name for name in names if names.count(name) > 1]
        if not names or twice:
            what = f"'{twice[0]}' stands there twice" if twice else "it is empty"
            raise StudyError(f"cases.{axis}: {what}")
    return axes


def _combine_axes(axes: Mapping[str, tuple[Case, ...]]) -> Iterator[Combination]:
    """The product of axes, of which a case may put others in the place of later ones."""
    if not axes:
        yield Combination({}, {}, {})
        return
    axis, *rest = axes
    for case in axes[axis]:
        own = _parse_axes(case.cases)
        for key in own:
            if key not in rest:
                raise StudyError(f"cases.{axis}.{case.name}.cases: {suggest(key, rest)}")
        for others in _combine_axes({key: own.get(key, axes[key]) for key in rest}):
            yield Combination(
                {axis: case.name, **others.names}, {**case.set, **others.set},
                {**case.published, **others.published},
            )  # fmt: skip


def _apply_overrides(values: dict[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    own = {f.name for f in dataclasses.fields(Study)}
    of_experiment = {}
    for key, value in overrides.items():
        if key.partition(".")[0] in own:
            values = with_override(values, key, value)
            continue
        check_key(key)
        values["vary"] = {k: v for k, v in dict(values.get("vary", {})).items() if k != key}
        of_experiment[key] = value
    if of_experiment:
        values["experiment"] = with_overrides(values.get("experiment", {}), of_experiment)
    return values


def _to_plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    told = f"{value!r} cannot stand in a study"  # a date, a set: YAML has such
    raise StudyError(f"{told}: give numbers, texts, lists and mappings")
