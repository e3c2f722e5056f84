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


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gian": 1}, "unknown key 'gian': did you mean 'gain'?"),
        ({"start": {"sid": 1}}, "unknown key 'start.sid': did you mean 'side'?"),
        ({"gain": "3"}, "gain is '3', must be a finite number"),
        ({"gain": True}, "gain is True, must be a finite number"),
        ({"gain": math.nan}, "gain is nan, must be a finite number"),
        ({"gain": "1e999"}, "gain is '1e999', must be a finite number"),
        ({"gain": 10**400}, f"gain is {'1' + 199 * '0'}..., must be a finite number"),
        ({"gain": 10**5000}, "gain is a number of thousands of digits, must be a finite number"),
        ({"gain": 0}, "gain is 0.0, must be > 0 1/s"),
        ({"gain": 10.1}, "gain is 10.1, must be <= 10 1/s"),
        ({"part": 1}, "part is 1.0, must be < 1"),
        ({"count": 0}, "count is 0, must be >= 1"),
        ({"count": 2.0}, "count is 2.0, must be a whole number"),
        ({"count": "1e1"}, "count is '1e1', must be a whole number"),
        ({"count": True}, "count is True, must be a whole number"),
        ({"count": 10**5000},
         "count is a number of thousands of digits, must be a whole number"),
        ({"quiet": 1}, "quiet is 1, must be true or false"),
        ({"quiet": "true"}, "quiet is 'true', must be true or false"),
        ({"mode": "fats"}, "mode is 'fats': did you mean 'fast'?"),
        ({"mode": "x"}, "mode is 'x': use one of fast, slow"),
        ({"mode": 4}, "mode is 4, must be one of fast, slow"),
        ({"limit": "x"}, "limit is 'x', must be a finite number"),
        ({"pair": [1]}, "pair is [1], must be a list of 2 finite numbers"),
        ({"pair": "one two"}, "pair[0] is 'one', must be a finite number"),
        ({"pair": [0, math.inf]}, "pair[1] is inf, must be a finite number"),
        ({"start": {"side": -1}}, "start.side is -1.0, must be >= 0 m"),
        ({"start": True}, "start is True, must be a text or a list of finite numbers or a "
                          "mapping"),
        ({"names": [1]}, "names[0] is 1, must be a text"),
        ({"lead": "high"}, "lead is 'high', must be a number, or one by joint"),
        ({"lead": {"J1": "x"}}, "lead.J1 is 'x', must be a finite number"),
        ({"lead": {"J1": -1}}, "lead.J1 is -1.0, must be >= 0"),
        ({"options": {2.5: 1}}, "options has the key 2.5; write all keys as texts"),
        ({"options": [1]}, "options is [1], must be a mapping"),
        ({"folder": "/"}, "unknown key 'folder': did you mean 'mode'?"),
        ({"x": "/"}, "unknown key 'x': use one of gain, part, count, quiet, mode, start, limit, "
                     "pair, names, lead, options"),
        ([1], "Outer is [1], must be a mapping"),
        ({"start": {"pose": None}}, "start.pose is None, must be a list of 2 finite numbers"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(values, message):
    with pytest.raises(OwnError) as caught:
        of(values)
    assert str(caught.value) == message


@dataclass(frozen=True)
class Reach:
    far: float = parameter(math.inf, "m", above=0.0, infinite=True)


def test_infinity_is_a_number_where_that_is_said():
    assert build(Reach, {"far": parse_yaml(".inf", "text", OwnError)}, "", OwnError).far == math.inf
    for value in (math.nan, "far"):
        with pytest.raises(OwnError) as caught:
            build(Reach, {"far": value}, "", OwnError)
        assert str(caught.value) == f"far is {value!r}, must be a number, or .inf"
    with pytest.raises(OwnError, match="^far is -inf, must be > 0 m$"):
        build(Reach, {"far": -math.inf}, "", OwnError)


def test_paths_begin_with_where_the_settings_stand():
    for where, unknown, wrong in (
        ("parameter ~", "unknown parameter ~gian: did", "parameter ~gain is 'x', must"),
        ("parameter /a/", "unknown parameter /a/gian: did", "parameter /a/gain is 'x', must"),
        ("goal.yaml: ", "goal.yaml: unknown key 'gian': did", "goal.yaml: gain is 'x', must"),
        ("arm", "unknown key 'arm.gian': did", "arm.gain is 'x', must"),
    ):
        with pytest.raises(OwnError) as caught:
            of({"gian": 1}, where)
        assert str(caught.value).startswith(unknown)
        with pytest.raises(OwnError) as caught:
            of({"gain": "x"}, where)
        assert str(caught.value).startswith(wrong)
    with pytest.raises(OwnError, match="^goal.yaml is None, must be a mapping$"):
        of(None, "goal.yaml: ")


def test_a_key_that_is_needed_is_named():
    with pytest.raises(OwnError, match="^start.pose is missing: give a list of 2 finite"):
        build(Other, {}, "start", OwnError)


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
    with pytest.raises(OwnError, match="^parameter /c/pid/d is missing: give a finite number$"):
        read(values, "d", float, "/c/pid", OwnError)
    with pytest.raises(OwnError, match="^parameter /c/pid/flag is True, must be a finite number$"):
        read(values, "flag", float, "/c/pid", OwnError)


def test_a_file_is_read_or_refused_at_once(tmp_path):
    good = tmp_path / "good.yaml"
    good.write_text("a: {b: [1, 2]}")
    read_yaml(good, OwnError)["a"]["b"].append(3)
    assert read_yaml(good, OwnError) == {"a": {"b": [1, 2]}}  # the caller's own
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, "/dev/zero"):
        with pytest.raises(OwnError, match="not a regular file"):
            read_yaml(path, OwnError)
    with pytest.raises(OwnError, match="cannot read .*none.yaml: No such file"):
        read_yaml(tmp_path / "none.yaml", OwnError)
    with pytest.raises(OwnError, match="cannot read"):
        read_yaml("a\0b", OwnError)
    (tmp_path / "large").write_text("# " + 1_000_000 * "x")
    with pytest.raises(OwnError, match="more than 1000000 bytes"):
        read_yaml(tmp_path / "large", OwnError)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [", "while parsing"), ("a: !!python/object:os.system {}", "could not determine"),
        ("9" * 5000, "Exceeds the limit .4300 digits."), ("2026-13-01", "month must be in 1..12"),
        (20_000 * "[", "recursion"), ("\x00", "special characters"),
    ],
)  # fmt: skip
def test_what_is_no_yaml_is_said_in_one_line(tmp_path, text, words):
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(OwnError, match=f"bad.yaml is not valid YAML: .*{words}") as caught:
        read_yaml(file, OwnError)
    assert "\n" not in str(caught.value) and "set_int_max" not in str(caught.value)


def test_a_file_of_another_encoding_is_told(tmp_path):
    (tmp_path / "bad.yaml").write_bytes(b"\xff\xfe")
    with pytest.raises(OwnError, match="bad.yaml is not UTF-8 text: "):
        read_yaml(tmp_path / "bad.yaml", OwnError)


def test_the_nearest_name_is_asked_after_or_all_are_told():
    assert suggest("cuont", ["count", "rate"]) == "did you mean 'count'?"
    assert suggest("xyz", ["count", "rate"]) == "use one of count, rate"
    assert suggest(2015, ["2016", "x"]) == "did you mean '2016'?"


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


@pytest.mark.parametrize(("given", "expected"), [
    (("arm", "eye", "image"), "/arm/eye/image"), (("/arm/", "eye/image"), "/arm/eye/image"),
    (("arm", "/image"), "/image"), (("arm", "/eye", "image"), "/eye/image"),
    (("", "image"), "/image"), (("/", ""), "/"),
])  # fmt: skip
def test_names_are_resolved_as_node_handles_do(given, expected):
    assert resolve_name(*given) == expected

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
