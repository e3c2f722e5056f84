"""Settings of a study: a base experiment, variations of its settings, repetitions and a seed.

The runs are numbered from 0. The number of a run determines its settings and its seed, on any
machine.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aras_visual_servo_base.lazy_imports import import_later
from aras_visual_servo_base.memory import ByteLimitedCache
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.settings import SettingsBase, build, check, parameter
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import ExperimentError, StudyError
from ..experiment.experiment import RENAMED_KEYS, Experiment
from ..experiment.experiment_keys import check_key
from ..experiment.overrides import with_override, with_overrides
from ..metrics import metrics as known_metrics
from ..metrics.formatting import format_count, format_rows
from .columns import check_columns
from .variation_case import Combination, VariationCase, combine_axes, parse_axes
from .variations import RandomVariation, VariationAxis, derive_seed, draw_values, parse_variation

if TYPE_CHECKING:
    from ..setup.run_setup import GoalImages

# largest number of runs of a study: at most 1e6 chunks, for Dask's scheduler, of 100 runs each
MAX_RUNS = 100_000_000
MAX_CHUNK = 10_000
GOAL_IMAGE_BYTES = 20_000_000  # memory for the images of goals in each process
IMAGE_CHUNK = 4  # maximum number of runs per chunk if images are stored, which need much memory
# Keys of a study that describe its results and do not change its runs.
DESCRIPTIVE_KEYS = ("source", "chosen", "judged")


@dataclass(frozen=True)
class Study(SettingsBase):
    """Settings of a study: a base experiment, variations of its settings, repetitions and a seed.

    `run` runs the study and returns its `Results`. The results are always bit-identical, even after
    interruptions and on several machines. A wrong key or value raises a StudyError before the first
    run.

    experiment: keys of the base experiment, an Experiment, or the path of its YAML file.
    vary: settings to vary: for each dotted key a list of values, a grid or a distribution; see
        variations.py.
    source: publication that the study reproduces.
    chosen: choices made where this publication is ambiguous, as text.
    cases: list of sets of keys and values, each combined with all variations; or named axes, each a
        list of Case, which are combined with each other (the last axis varies fastest).
    samples: number of draws from the distributions.
    sampling: how values are drawn from the distributions: 'random' or 'sobol'.
    repeats: number of runs per point; a point is a combination of values of all settings that vary.
    seed: seed of all random numbers.
    seeds: 'runs' gives each run a different seed; 'repeats' gives repeat n of every point the same
        seed, so that all points have the same starts and noise; 'counted' gives repeat n of every
        point the seed `seed` + n.
    metrics: names of metrics, or 'package.module:function'; empty: the default metrics.
    judged: name of the metric that defines success; its value is 1 for a successful run.
    chunk: number of runs per task and result file; None: depends on the number of runs.
    traces: whether to store features, twists, joints and poses of every image.
    pictures: images to store, of every camera: 'none', 'all', or only the 'first' image of each
        run, after which the run ends; see image_table.py.
    depth: whether to store depth images, too.
    limit: maximum wall time of a run, s; a run that exceeds it gets the outcome 'time_limit'.
    """

    fault = StudyError

    experiment: Mapping[str, Any] | str = parameter({})
    vary: Mapping[str, Any] = parameter({})
    cases: tuple[Mapping[str, Any], ...] | Mapping[str, Any] = ()
    samples: int = parameter(1, least=1)
    sampling: str = parameter("random", choices=("random", "sobol"))
    repeats: int = parameter(1, least=1)
    seed: int = parameter(0, least=0)
    seeds: str = parameter("runs", choices=("runs", "repeats", "counted"))
    metrics: tuple[str, ...] = ()
    judged: str = known_metrics.success.name
    chunk: int | None = parameter(None, "runs", least=1, most=MAX_CHUNK)
    traces: bool = False
    pictures: str = parameter("none", choices=("none", "first", "all"))
    depth: bool = False
    limit: float = parameter(900.0, "s", above=0.0)
    source: str = ""
    chosen: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check(self, StudyError)
        if isinstance(self.experiment, str):
            content = read_yaml(self.experiment, StudyError, "the experiment") or {}
            if not isinstance(content, Mapping):
                raise StudyError(
                    f"{self.experiment} is not an experiment: write a mapping of keys to values "
                    "into it"
                )
            object.__setattr__(self, "experiment", content)
        if "seed" in self.experiment:
            raise StudyError(
                "seed belongs to the study, not to its experiment, because every run has its own "
                "seed: move seed out of experiment"
            )
        renamed = [key for key in RENAMED_KEYS if key in self.experiment]
        varied = [key for key in self.keys if key not in self.case_axes]
        settings = [key for combination in self.combinations for key in combination.set]
        for key in (*renamed, *varied, *settings):
            check_key(key)
        if self.samples > 1 and not self.random_variations:
            raise StudyError(
                f"samples is {self.samples}, but no key has a distribution: set repeats instead, "
                "or give a key under vary a distribution"
            )
        if self.run_count > MAX_RUNS:
            raise StudyError(
                f"{self.run_count:.3g} runs are more than {MAX_RUNS:g}: make the grid, samples or "
                "repeats smaller"
            )
        # An unknown metric is reported here, because a worker would report it only after a run.
        for name in self.metric_names:
            try:
                known_metrics.find_metric(name)
            except StudyError as error:
                raise StudyError(f"metrics: {error}") from None
        check_columns(self.keys, self.metric_names)
        if self.judged not in (known_metrics.success.name, *self.metric_names):
            raise StudyError(f"judged is '{self.judged}', which is not among the study's metrics: "
                             f"{suggest(self.judged, self.metric_names)}")  # fmt: skip

    def __repr__(self) -> str:
        """Describe the study in at most four lines; `to_mapping` returns all settings."""
        keys = {axis.key: format_count(len(axis.values), "value") for axis in self.axes}
        keys |= {one.key: "random" for one in self.random_variations}
        cases = "" if not self.cases else f", {format_count(len(self.combinations), 'case')}"
        return format_rows({
            "Study": f"{format_count(self.run_count, 'run')}: "
                     f"{format_count(self.point_count, 'point')}{cases}, {self.repeats} of each",
            "experiment": ", ".join(f"{key} {value}" for key, value in self.experiment.items()),
            "varies": ", ".join(f"{key} ({text})" for key, text in keys.items()),
            "metrics": ", ".join(self.metrics),
        })  # fmt: skip

    @classmethod
    def from_mapping(cls, values: Any) -> Study:
        """Make a study from keys and values.

        Raises:
            StudyError: a key or value is wrong; the message suggests a correct one.
        """
        return build(cls, values, "", StudyError)

    @classmethod
    def from_yaml(cls, path: str | Path, overrides: Mapping[str, Any] | None = None) -> Study:
        """Read a study from a YAML file.

        Args:
            path: path of the YAML file.
            overrides: values by dotted key of the study (`repeats`) or of its experiment (`gain`,
                `start.side`); these keys of the experiment are then not varied.

        Raises:
            StudyError: the file cannot be read, or a key or value is wrong.
        """
        values = read_yaml(path, StudyError)
        if not isinstance(values, Mapping):
            raise StudyError(f"{path} is not a study: write a mapping of keys to values into it")
        values = dict(values)
        base = values.get("experiment")
        # A relative path refers to the folder of the study's file or, if there is no such file
        # there, to the current folder.
        if isinstance(base, str):
            sibling = Path(path).parent / base
            file = sibling if sibling.is_file() else base
            values["experiment"] = read_yaml(file, StudyError) or {}
        return cls.from_mapping(_apply_overrides(values, overrides or {}))

    def to_mapping(self) -> dict[str, Any]:
        """Return the study as plain values, as input of `from_mapping`."""
        return json.loads(json.dumps({
            f.name: getattr(self, f.name) for f in dataclasses.fields(self)
        }, default=_to_plain))  # fmt: skip

    @cached_property
    def goal_images(self) -> GoalImages:
        """Images of goals, which the runs of this study share in one process."""
        return ByteLimitedCache(
            GOAL_IMAGE_BYTES, lambda frames: sum(frame.image.nbytes for frame in frames.values())
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies and other processes, which make images of their own."""
        return {name: value for name, value in self.__dict__.items() if name != "goal_images"}

    @cached_property
    def digest(self) -> str:
        """Digest of the settings that determine the runs; the layout of the file has no effect."""
        settings = {k: v for k, v in self.to_mapping().items() if k not in DESCRIPTIVE_KEYS}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()

    def run(
        self, path: str | Path | None = None, progress: bool = True, workers: int = 1
    ) -> Any:
        """Run the missing runs of the study, and return the results of all runs.

        An interrupted study is continued by the same call, with the same results.

        Args:
            path: folder of the results; new, or of this study. None: the results are returned
                without being stored.
            progress: show a progress bar on the standard error.
            workers: number of processes on this machine; 1: this process; 0: one per core.

        Returns:
            One row per run, with its settings, outcome, verdict and metrics.

        Raises:
            StudyError: a setting is wrong; no folder is given although the study stores images or
                traces; the folder contains another study; or the study was started with other code.
        """
        run_study = import_later("aras_visual_servo_bench.studies.run_study:run_study")
        return run_study(self, path, workers, progress)

    @cached_property
    def _variations(self) -> tuple[VariationAxis | RandomVariation, ...]:
        return tuple(parse_variation(str(key), given) for key, given in self.vary.items())

    @cached_property
    def axes(self) -> tuple[VariationAxis, ...]:
        """Settings that vary over a list of values; all their combinations form the grid."""
        return tuple(v for v in self._variations if isinstance(v, VariationAxis))

    @cached_property
    def random_variations(self) -> tuple[RandomVariation, ...]:
        """Settings whose values are drawn from a distribution."""
        return tuple(v for v in self._variations if isinstance(v, RandomVariation))

    @cached_property
    def case_axes(self) -> dict[str, tuple[VariationCase, ...]]:
        """Cases of each named axis, by the name of the axis; {} if there are no named axes."""
        return parse_axes(self.cases) if isinstance(self.cases, Mapping) else {}

    @cached_property
    def combinations(self) -> tuple[Combination, ...]:
        """Combinations of cases, in order; without cases, a single combination without settings."""
        if isinstance(self.cases, Mapping):
            return tuple(combine_axes(self.case_axes))
        return tuple(Combination({}, case, {}) for case in self.cases) or (Combination({}, {}, {}),)

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Names of the columns with settings that differ between runs, in the study file's order.

        A name is a dotted key of the experiment, or the name of an axis of cases.
        """
        listed = () if self.case_axes else self.cases
        case_keys = (*self.case_axes, *dict.fromkeys(str(key) for case in listed for key in case))
        both = [v.key for v in self._variations if v.key in case_keys]
        if both:
            raise StudyError(f"'{both[0]}' is both under vary and in cases: remove one of them")
        return (*case_keys, *(v.key for v in self._variations))

    @cached_property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the metrics that are computed for each run."""
        defaults = (name for name, one in known_metrics.METRICS.items() if one.default)
        return self.metrics or tuple(defaults)

    @cached_property
    def point_count(self) -> int:
        """Number of points, that is, of different combinations of settings."""
        grid = math.prod(len(axis.values) for axis in self.axes)
        return len(self.combinations) * grid * self.samples

    @property
    def run_count(self) -> int:
        """Number of runs of the study."""
        return self.point_count * self.repeats

    @property
    def chunk_size(self) -> int:
        """Number of runs per chunk; each chunk is a task for a worker.

        By default, a chunk has at most 100 runs, or IMAGE_CHUNK runs if images are stored, and the
        study has about 40 chunks or more, so that all cores have work.
        """
        most = IMAGE_CHUNK if self.pictures == "all" else 100
        return self.chunk or min(max(math.ceil(self.run_count / 40), 1), most)

    @property
    def has_image_rows(self) -> bool:
        """True if the study stores a row of data for each image, with or without the image."""
        return self.traces or self.pictures != "none"

    @property
    def chunk_count(self) -> int:
        """Number of chunks; a chunk is a task for a worker, and has a result file."""
        return math.ceil(self.run_count / self.chunk_size)

    def list_chunk_runs(self, chunk: int) -> range:
        """Return the numbers of the runs of a chunk."""
        first = chunk * self.chunk_size
        return range(first, min(first + self.chunk_size, self.run_count))

    def count_runs(self, chunks: Iterable[int]) -> int:
        """Count the runs of several chunks."""
        return sum(len(self.list_chunk_runs(chunk)) for chunk in chunks)

    def find_combination(self, point: int) -> Combination:
        """Return the cases of the combination of settings (point) with the number `point`."""
        return self.combinations[point // (self.point_count // len(self.combinations))]

    def make_settings(self, point: int) -> dict[str, Any]:
        """Return the varied settings of the combination (point) with the number `point`, by column.
        """
        cases = self.find_combination(point)
        settings = {**(cases.names or cases.set), **self._compute_variations(point)}
        return {key: settings[key] for key in self.keys if key in settings}

    def _compute_variations(self, point: int) -> dict[str, Any]:
        """Compute the values of the settings under `vary` for point number `point`, by dotted key.
        """
        rest, sample = divmod(point, self.samples)
        values: dict[str, Any] = {}
        for axis in reversed(self.axes):
            rest, index = divmod(rest, len(axis.values))
            values[axis.key] = axis.values[index]
        values.update(draw_values(self.random_variations, self.sampling, self.seed, sample))
        return {v.key: values[v.key] for v in self._variations}

    def compute_seed(self, run: int) -> int:
        """Compute the seed of a run from its number and the seed of the study."""
        if self.seeds == "counted":
            return self.seed + run % self.repeats
        return derive_seed(self.seed, run % self.repeats if self.seeds == "repeats" else run)

    def make_experiment(self, run: int) -> Experiment:
        """Make the experiment of a run.

        Raises:
            ExperimentError: the combination of settings is not possible.
        """
        point = run // self.repeats
        settings = {**self.find_combination(point).set, **self._compute_variations(point)}
        return self._build_experiment(settings, self.compute_seed(run))

    def _build_experiment(self, settings: Mapping[str, Any], seed: int) -> Experiment:
        values = with_overrides(self.experiment, settings)
        values.setdefault("seed", seed)
        return Experiment.from_mapping(values)

    def make_trials(self) -> list[Experiment]:
        """Return a few experiments that contain every value of the study, to check these values.

        Raises:
            StudyError: an experiment is wrong; the message names the key.
        """
        varied = self._compute_variations(0)
        first = {**self.combinations[0].set, **varied}
        trials: list[dict[str, Any]] = [{**cases.set, **varied} for cases in self.combinations]
        trials += [{**first, axis.key: v} for axis in self.axes for v in axis.values[1:]]
        trials += [{**first, draw.key: v} for draw in self.random_variations for v in draw.ends]
        try:
            return [self._build_experiment(settings, self.compute_seed(0)) for settings in trials]
        except ExperimentError as error:
            raise StudyError(str(error)) from error


def _apply_overrides(values: dict[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    study_keys = {f.name for f in dataclasses.fields(Study)}
    experiment_overrides = {}
    for key, value in overrides.items():
        if key.partition(".")[0] in study_keys:
            values = with_override(values, key, value)
            continue
        check_key(key)
        values["vary"] = {k: v for k, v in dict(values.get("vary", {})).items() if k != key}
        experiment_overrides[key] = value
    if experiment_overrides:
        values["experiment"] = with_overrides(values.get("experiment", {}), experiment_overrides)
    return values


def _to_plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    # YAML can also contain dates and sets, which a study cannot use.
    raise StudyError(
        f"{value!r} cannot be used in a study: use numbers, texts, lists and mappings"
    )
