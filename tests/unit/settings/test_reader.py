"""The reader of settings: kinds, bounds, paths of keys, files; and names of classes."""

import importlib
import math
import os
import pickle
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aras_visual_servo_base.names import import_object, resolve_name, suggest
from aras_visual_servo_base.registry import Registry
from aras_visual_servo_base.settings import build, check, list_defaults, parameter, read, to_mapping
from aras_visual_servo_base.yaml_files import parse_yaml, read_yaml


class OwnError(Exception):
    pass


@dataclass(frozen=True)
class Inner:
    side: float = parameter(0.5, "m", least=0.0)
    turn: float = 0.0


@dataclass(frozen=True)
class Other:
    pose: tuple[float, float]


@dataclass(frozen=True)
class Outer:
    gain: float = parameter(2.0, "1/s", above=0.0, most=10.0)
    part: float = parameter(0.0, below=1.0)
    count: int = parameter(3, least=1)
    quiet: bool = False
    mode: str = parameter("fast", choices=("fast", "slow"))
    start: str | tuple[float, ...] | Inner | Other = parameter("none", name=True)
    limit: float | None = None
    pair: tuple[float, float] = (0.0, 0.0)
    names: tuple[str, ...] = parameter((), splits_words=True)
    lead: float | tuple[float, ...] | Mapping[str, float] = parameter(
        0.1, least=0.0, expected="a number, or one by joint"
    )
    options: Mapping[str, Any] = parameter({})
    folder: Path = parameter(Path("."), internal=True)


def of(values, where=""):
    return build(Outer, values, where, OwnError)


@pytest.mark.parametrize(
    ("key", "text", "expected"),
    [
        ("gain", "1e1", 10.0), ("gain", "5.e-1", 0.5), ("gain", ".5", 0.5), ("gain", "+.5", 0.5),
        ("gain", "3", 3.0), ("count", "1", 1), ("lead", "0", 0.0),
        ("part", "-.5", -0.5), ("part", "-1e-2", -0.01), ("count", "7", 7),
        ("quiet", "yes", True), ("quiet", "true", True), ("limit", "null", None),
        ("limit", "2e0", 2.0), ("pair", "[1e0, .5]", (1.0, 0.5)),
        ("pair", "'1 -2e-1'", (1.0, -0.2)),
        ("start", "2016", "2016"), ("start", "[1, 2e0, 3]", (1.0, 2.0, 3.0)),
        ("start", "{side: 1e0}", Inner(1.0)), ("start", "{pose: [0, 1]}", Other((0.0, 1.0))),
        ("names", "a b", ("a", "b")), ("names", "[a]", ("a",)),
        ("lead", "{J1: 1e-1}", {"J1": 0.1}), ("lead", "[1e0, 2]", (1.0, 2.0)),
        ("options", "{1: x}", {"1": "x"}),
    ],
)  # fmt: skip
def test_values_of_a_yaml_file_come_in_the_kind_that_is_wanted(key, text, expected):
    found = getattr(of({key: parse_yaml(text, "text", OwnError)}), key)
    assert found == expected
    if isinstance(expected, bool | int | float | str):
        assert type(found) is type(expected)


@pytest.mark.parametrize(("values", "message"), [
    ({"start": {"sid": 1}}, "unknown key 'start.sid': did you mean 'side'?"),
    ({"side": 1}, "unknown key 'side': did you mean 'start.side'?"),
    ({"pose": 1}, "unknown key 'pose': did you mean 'start.pose'?"),
    ({"gain": "3"}, "gain is '3', must be a finite number"),
    ({"gain": 10**400}, f"gain is {'1' + 199 * '0'}..., must be a finite number"),
    ({"gain": 10**5000}, "gain is a number of thousands of digits, must be a finite number"),
    ({"gain": 0}, "gain is 0.0, must be > 0 1/s"),
    ({"gain": 10.1}, "gain is 10.1, must be <= 10 1/s"),
    ({"part": 1}, "part is 1.0, must be < 1"), ({"count": 0}, "count is 0, must be >= 1"),
    ({"count": 2.0}, "count is 2.0, must be a whole number"),
    ({"count": True}, "count is True, must be a whole number"),
    ({"mode": "fats"}, "mode is 'fats': did you mean 'fast'?"),
    ({"mode": "x"}, "mode is 'x': use one of fast, slow"),
    ({"mode": 4}, "mode is 4, must be one of fast, slow"),
    ({"pair": [1]}, "pair is [1], must be a list of 2 finite numbers"),
    ({"pair": "one two"}, "pair[0] is 'one', must be a finite number"),
    ({"pair": [0, math.inf]}, "pair[1] is inf, must be a finite number"),
    ({"start": {"side": -1}}, "start.side is -1.0, must be >= 0 m"),
    ({"start": True}, "start is True, must be a text or a list of finite numbers or a mapping"),
    ({"start": {"pose": None}}, "start.pose is None, must be a list of 2 finite numbers"),
    ({"names": [1]}, "names[0] is 1, must be a text"),
    ({"lead": "high"}, "lead is 'high', must be a number, or one by joint"),
    ({"lead": {"J1": -1}}, "lead.J1 is -1.0, must be >= 0"),
    ({"options": {2.5: 1}}, "options has the key 2.5; write all keys as texts"),
    ({"options": [1]}, "options is [1], must be a mapping"),
    ({"folder": "/"}, "unknown key 'folder': did you mean 'mode'?"),
    ({"x": "/"}, "unknown key 'x': use one of gain, part, count, quiet, mode, start, limit, "
                 "pair, names, lead, options"),
    ([1], "Outer is [1], must be a mapping"),
])  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(values, message):
    assert said(of, values) == message


@dataclass(frozen=True)
class Outermost:
    outer: Outer
    others: Mapping[str, Outer]


def test_a_key_that_belongs_into_mappings_inside_is_named_with_its_path():
    def read(values):
        build(Outermost, values, "a.yaml: ", OwnError)

    assert said(read, {"side": 1}) == "a.yaml: unknown key 'side': did you mean 'outer.start.side'?"
    assert said(read, {"outer": {"start": 1, "pose": 2}}) == (
        "a.yaml: unknown key 'outer.pose': did you mean 'start.pose'?")
    assert said(read, {"folder": 1}) == "a.yaml: unknown key 'folder': use one of outer, others"


@dataclass(frozen=True)
class Reach:
    far: float = parameter(math.inf, "m", above=0.0, infinite=True)


def said(call, *given):
    """What a call says of its error."""
    with pytest.raises(OwnError) as caught:
        call(*given)
    return str(caught.value)


def test_paths_begin_with_where_the_settings_stand():
    for where, unknown, wrong in (
        ("parameter ~", "unknown parameter ~gian: did", "parameter ~gain is 'x', must"),
        ("parameter /a/", "unknown parameter /a/gian: did", "parameter /a/gain is 'x', must"),
        ("goal.yaml: ", "goal.yaml: unknown key 'gian': did", "goal.yaml: gain is 'x', must"),
        ("arm", "unknown key 'arm.gian': did", "arm.gain is 'x', must"),
    ):
        assert said(of, {"gian": 1}, where).startswith(unknown)
        assert said(of, {"gain": "x"}, where).startswith(wrong)
    assert said(of, None, "goal.yaml: ") == "goal.yaml is None, must be a mapping"
    assert said(build, Other, {}, "start", OwnError).startswith(
        "start.pose is missing: give a list of 2 finite")
    reach = build(Reach, {"far": parse_yaml(".inf", "text", OwnError)}, "", OwnError)
    assert reach.far == math.inf  # a number where that is said
    for value, message in ((math.nan, "nan, must be a number, or .inf"),
                           ("far", "'far', must be a number, or .inf"),
                           (-math.inf, "-inf, must be > 0 m")):  # fmt: skip
        assert said(build, Reach, {"far": value}, "", OwnError) == f"far is {message}"


def test_bounds_hold_however_the_settings_were_made():
    check(Outer(), OwnError)
    for made, message in (
        (Outer(gain=math.nan), "a.gain is nan, must be a finite number"),
        (Outer(gain=0), "a.gain is 0.0, must be > 0 1/s"),
        (Outer(mode="x"), "a.mode is 'x': use one of"),
        (Outer(lead=(0.1, -1.0)), r"a.lead\[1\] is -1.0, must be >= 0"),
    ):
        with pytest.raises(OwnError, match=message):
            check(made, OwnError, "a")


def test_settings_made_in_python_hold_what_a_file_would_give():
    made = Outer(gain=np.float32(3), count=np.int64(4), start=np.arange(3), pair=range(2),
                 quiet=np.bool_(True), options={"at": np.eye(2), "by": Path("a/b")})  # fmt: skip
    check(made, OwnError)
    written = of({"gain": 3, "count": 4, "start": [0, 1, 2], "pair": [0, 1], "quiet": True,
                  "options": {"at": [[1.0, 0.0], [0.0, 1.0]], "by": "a/b"}})  # fmt: skip
    assert made == written and type(made.count) is int and type(made.quiet) is bool
    assert of(to_mapping(made)) == made


def test_defaults_are_listed_once_and_settings_go_to_other_processes():
    assert list_defaults(Outer)["gain"] == 2.0 and list_defaults(Other) == {}
    assert "folder" not in list_defaults(Outer)
    settings = of({"options": {"a": 1}})
    assert pickle.loads(pickle.dumps(settings)) == settings


def test_one_value_is_read_beside_those_of_others():
    values = {"p": "1e1", "flag": True, "theirs": None}
    assert read(values, "p", float, "/c/pid", OwnError) == 10.0
    assert read(values, "i", float, "/c/pid", OwnError, 0.0) == 0.0
    for key, wrong in (("d", "missing: give a finite number"),
                       ("flag", "True, must be a finite number")):  # fmt: skip
        told = said(read, values, key, float, "/c/pid", OwnError)
        assert told == f"parameter /c/pid/{key} is {wrong}"


def test_a_file_is_read_or_refused_at_once(tmp_path):
    good = tmp_path / "good.yaml"
    good.write_text("a: {b: [1, 2]}")
    read_yaml(good, OwnError)["a"]["b"].append(3)
    assert read_yaml(good, OwnError) == {"a": {"b": [1, 2]}}  # the caller's own
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_text("# " + 1_000_000 * "x")
    (tmp_path / "bad.yaml").write_bytes(b"\xff\xfe")
    for path, words in (
        (tmp_path / "pipe", "not a regular file"), (tmp_path, "not a regular file"),
        ("/dev/zero", "not a regular file"), ("a\0b", "cannot read"),
        (tmp_path / "none.yaml", "none.yaml: No such file"),
        (tmp_path / "large", "more than 1000000 bytes"),
        (tmp_path / "bad.yaml", "bad.yaml is not UTF-8 text: "),
    ):  # fmt: skip
        assert words in said(read_yaml, path, OwnError)


@pytest.mark.parametrize(("text", "words"), [
    ("a: [", "while parsing"), ("a: !!python/object:os.system {}", "could not determine"),
    ("9" * 5000, "Exceeds the limit (4300 digits)"), ("2026-13-01", "month must be in 1..12"),
    (20_000 * "[", "recursion"), ("\x00", "special characters"),
])  # fmt: skip
def test_what_is_no_yaml_is_said_in_one_line(tmp_path, text, words):
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    told = said(read_yaml, file, OwnError)
    assert "bad.yaml is not valid YAML: " in told and words in told
    assert "\n" not in told and "set_int_max" not in told


def test_a_class_is_found_by_name_or_by_its_module():
    known = Registry("scheme", "xml", (Outer,), OwnError)
    assert known.register("outer")(Outer).name == "outer"
    assert known.find("outer") is Outer and known["outer"] is Outer and list(known) == ["outer"]
    assert known.find(f"{__name__}:Outer") is Outer
    with pytest.raises(OwnError, match=f"scheme 'outer' already exists .{__name__}:Outer"):
        known.register("outer")(Inner)
    assert import_object("metric", "math:pi", OwnError) == math.pi
    for name, words in (
        ("outre", "unknown scheme 'outre': did you mean 'outer'? Or use one of outer, or 'pack"),
        ("a:", "unknown scheme 'a:'"),
        ("no_such:X", "scheme 'no_such:X': cannot import no_such"),
        ("math:Pie", "scheme 'math:Pie': math has no Pie"),
        (f"{__name__}:Outr", "has no Outr: did you mean 'Outer'?"),
        (f"{__name__}:Inner", "Inner is not a class derived from Outer"),
        ("math:pi", "pi is not a class derived from Outer"),
    ):
        with pytest.raises(OwnError) as caught:
            known.find(name)
        assert words in str(caught.value)


def test_names_are_resolved_as_node_handles_do_and_the_nearest_is_asked_after():
    for given, expected in (
        (("arm", "eye", "image"), "/arm/eye/image"), (("/arm/", "eye/image"), "/arm/eye/image"),
        (("arm", "/image"), "/image"), (("arm", "/eye", "image"), "/eye/image"),
        (("", "image"), "/image"), (("/", ""), "/"),
    ):  # fmt: skip
        assert resolve_name(*given) == expected
    for name, known, words in (("cuont", "count", "did you mean 'count'?"),
                               ("xyz", "count", "use one of count, rate"),
                               (2015, "2016", "did you mean '2016'?")):  # fmt: skip
        assert suggest(name, [known, "rate"]) == words


def test_an_entry_is_one_file_of_its_folder(tmp_path, monkeypatch):
    """Modules are imported when they are needed, that of the entry's own name first."""
    monkeypatch.syspath_prepend(str(tmp_path))
    folder = tmp_path / "kind_of_test"
    folder.mkdir()
    (folder / "__init__.py").write_text(
        "from aras_visual_servo_base.registry import Registry\n"
        "KIND = Registry('kind', __name__, (object,), ValueError)\n"
    )
    for module, names in (("first", ["a", "b"]), ("second", ["second"]), ("third", ["c"])):
        (folder / f"{module}.py").write_text(
            "from . import KIND\nfrom dataclasses import dataclass\n"
            "from aras_visual_servo_base.settings import parameter\n" + "".join(
                f"@KIND.register('{name}')\n@dataclass\nclass K{name}:\n"
                "    gain: float = parameter(2.0, '1/s', above=0.0, most=9.0, help='how fast')\n"
                for name in names)
        )  # fmt: skip
    kind = importlib.import_module("kind_of_test").KIND

    def loaded():
        return {name.rpartition(".")[2] for name in sys.modules if name.startswith("kind_of_test.")}

    assert kind.create("second", gain=3.0).gain == 3.0 and loaded() == {"second"}
    assert "b" in kind and loaded() == {"first", "second"}
    assert list(kind) == ["a", "b", "c", "second"] and len(kind) == 4 and "d" not in kind
    (parameter,) = kind.list_parameters("c")
    assert parameter == ("gain", "a finite number", 2.0, "1/s", "> 0 and <= 9", "how fast")
    both = Registry("one", "xml", (object,), ValueError, (kind,))
    assert both["c"] is kind["c"] and list(both) == list(kind)
    for make, words in (
        (lambda: kind.create("c", gian=1.0), "kind 'c' takes no 'gian': did you mean 'gain'"),
        (lambda: both.find("sekond"), "unknown one 'sekond': did you mean 'second'?"),
        (lambda: kind.create("c", 1.0, gain=1.0), "kind 'c': multiple values"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            make()
