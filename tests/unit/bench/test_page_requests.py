"""Requests of the live page, and their limits."""

import json
import math
import re
from pathlib import Path

import pytest

from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.web.live import page_state as page
from aras_visual_servo_bench.web.live.page_requests import REQUESTS, read_request
from aras_visual_servo_bench.web.page_messages import read_message
from aras_visual_servo_controller.teleop.keyboard import CAMERA_KEYS

AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
CHOICES = {"schemes": ["moments"], "laws": ["pi"], "starts": ["2016"], "goals": ["auto"],
           "gains": ["gain"], "joints": ["J1"], "cameras": ["wide"], "targets": []}  # fmt: skip


def ask(do, **given):
    return read_request(*read_message(json.dumps({"do": do, **given}), REQUESTS), CHOICES)


def test_a_request_is_read_as_it_was_sent():
    request = ask("servo", scheme="moments", law="pi", start="2016", goal="auto")
    assert request.do == "servo"
    assert request.arguments == {"scheme": "moments", "law": "pi", "start": "2016", "goal": "auto"}
    assert ask("jog", wz=-0.5).arguments == {
        "vx": 0.0, "vy": 0.0, "vz": 0.0, "wx": 0.0, "wy": 0.0, "wz": -0.5}
    assert ask("step", steps=5).arguments == {"steps": 5}


@pytest.mark.parametrize(("do", "given", "why"), [
    ("strat", {}, "there is no request 'strat': did you mean 'start'?"),
    ("step", {}, "step: steps is missing: give a whole number"),
    ("step", {"steps": 0}, "step: steps is 0, must be >= 1"),
    ("step", {"steps": 10001}, "step: steps is 10001, must be <= 10000"),
    *(("step", {"steps": value}, f"steps is {value!r}, must be a whole number")
      for value in (True, "5", 2.5)),
    ("gain", {"name": "gain", "value": 0.0}, "gain: value is 0.0, must be >= 0.001"),
    ("gain", {"name": "gain", "value": float("nan")}, "value is nan, must be a finite number"),
    ("gain", {"name": "gain", "value": 10**3900}, "..., must be a finite number"),
    ("gain", {"name": "gian", "value": 1.0},
     "gain: name is 'gian', which does not exist: did you mean 'gain'?"),
    ("gain", {"name": ["gain"], "value": 1.0}, "name is ['gain'], must be a text"),
    ("start", {"now": 1}, "start: unknown key 'now'"),
    *(("jog", {axis: 0.26}, f"jog: {axis} is 0.26, must be <= 0.25") for axis in AXES[:3]),
    *(("jog", {axis: -1.1}, f"jog: {axis} is -1.1, must be >= -1") for axis in AXES[3:]),
    ("jog_joint", {"joint": "J1", "speed": -1.01}, "must be >= -1"),
    *(("goal", {axis: -0.31}, f"goal: {axis} is -0.31, must be >= -0.3") for axis in "xyz"),
    ("goal", {"turn": 3.2}, "goal: turn is 3.2, must be <= 3.14159"),
    *(("servo", {"scheme": "moments", "law": "pi", "start": "2016", "goal": "auto", key: "/etc/x"},
       f"use one of {known}")
      for key, known in (("law", "pi"), ("start", "2016"), ("goal", "auto"))),
    ("camera", {"preset": "../wide"},
     "camera: preset is '../wide', which does not exist: did you mean 'wide'?"),
    ("target", {"name": "poster"}, "name is 'poster', which does not exist: none is available"),
    ("teach", {"name": "../mine"},
     "teach: name is '../mine', must be 1 to 40 letters, digits, - or _"),
    ("teach", {"name": "a" * 41}, "must be 1 to 40"),
    ("teach", {"name": "a\n"}, "letters, digits")])  # fmt: skip
def test_what_is_wrong_is_refused_with_the_reason(do, given, why):
    with pytest.raises(RefusedRequestError) as refused:
        ask(do, **given)
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("do", "given"), [
    ("step", {"steps": 1}), ("step", {"steps": 10000}), ("teach", {"name": "a" * 40}),
    *(("gain", {"name": "gain", "value": value}) for value in (0.001, 100.0)),
    *(("jog_joint", {"joint": "J1", "speed": sign}) for sign in (-1.0, 1.0)),
    *(("jog", {axis: sign * (0.25 if axis[0] == "v" else 1.0) for axis in AXES})
      for sign in (-1, 1)),
    *(("goal", {"x": sign * 0.3, "y": sign * 0.3, "z": sign * 0.3, "turn": sign * math.pi})
      for sign in (-1, 1))])  # fmt: skip
def test_what_is_just_within_its_bounds_is_taken(do, given):
    assert {key: vars(ask(do, **given))["arguments"][key] for key in given} == given


def test_a_request_of_4096_characters_is_read():
    text = json.dumps({"do": "start"})
    assert read_message(text.ljust(4096), REQUESTS) == ("start", {})
    with pytest.raises(RefusedRequestError, match="a text of at most 4096 characters"):
        read_message(text.ljust(4097), REQUESTS)
    for wrong in ('{"do": 1}', "[" * 4000):
        with pytest.raises(RefusedRequestError, match="a request must be a JSON object"):
            read_message(wrong, REQUESTS)


def test_the_pages_keys_are_those_of_the_terminal():
    script = (Path(page.__file__).parent / "page" / "jog.js").read_text()
    text = re.search(r"const KEYS = \{(.*?)\};", script, re.DOTALL)[1]
    found = {key: (AXES.index(axis), float(sign))
             for key, axis, sign in re.findall(r'(\w): \["(\w\w)", (-?1)\]', text)}
    assert found == CAMERA_KEYS
