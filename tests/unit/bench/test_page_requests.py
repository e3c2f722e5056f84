"""What a page may ask for, and who may ask at all."""

import json
import re
from pathlib import Path

import pytest

from aras_visual_servo_bench.live import page
from aras_visual_servo_bench.live.access import Access
from aras_visual_servo_bench.live.requests import LARGEST, REQUESTS, RefusedError, read_request
from aras_visual_servo_controller.hands.teleop import CAMERA_KEYS

AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
CHOICES = {"schemes": ["moments"], "laws": ["pi"], "starts": ["2016"], "goals": ["auto"],
           "gains": ["gain"], "joints": ["J1"], "cameras": ["wide"], "targets": []}  # fmt: skip


def ask(do, **given):
    return read_request(json.dumps({"do": do, **given}), CHOICES)


def test_a_request_is_read_as_it_was_sent():
    request = ask("servo", scheme="moments", law="pi", start="2016", goal="auto")
    assert request.do == "servo"
    assert request.given == {"scheme": "moments", "law": "pi", "start": "2016", "goal": "auto"}
    assert ask("jog", wz=-0.5).given == {
        "vx": 0.0, "vy": 0.0, "vz": 0.0, "wx": 0.0, "wy": 0.0, "wz": -0.5}
    assert ask("step", steps=5).given == {"steps": 5}
    assert isinstance(ask("step", steps=5.0).given["steps"], int)


@pytest.mark.parametrize(("do", "given", "why"), [
    ("strat", {}, "did you mean 'start'?"),
    ("step", {}, "'steps' is missing"),
    ("step", {"steps": 0}, "steps is 0: it must be 1 to 10000"),
    ("step", {"steps": 10001}, "it must be 1 to 10000"),
    ("step", {"steps": True}, "it must be a number"),
    ("step", {"steps": "5"}, "it must be a number"),
    ("step", {"steps": 2.5}, "a whole number"),
    ("gain", {"name": "gain", "value": 0.0}, "it must be 0.001 to 100"),
    ("gain", {"name": "gain", "value": float("nan")}, "it must be 0.001 to 100"),
    ("gain", {"name": "gain", "value": 10**3900}, "value is inf: it must be 0.001 to 100"),
    ("jog", {"vx": -10**3900}, "vx is -inf: it must be"),
    ("gain", {"name": "gian", "value": 1.0}, "there are gain"),
    ("gain", {"name": ["gain"], "value": 1.0}, "there are gain"),
    ("start", {"now": 1}, "start takes no 'now'"),
    ("jog", {"vx": 1.0}, "vx is 1: it must be -0.25 to 0.25"),
    ("jog", {"wx": -1.1}, "it must be -1 to 1"),
    ("jog_joint", {"joint": "J4", "speed": 0.1}, "there are J1"),
    ("goal", {"z": 0.31}, "it must be -0.3 to 0.3"),
    ("servo", {"scheme": "os:system", "law": "pi", "start": "2016", "goal": "auto"},
     "scheme is 'os:system': there are moments"),
    ("servo", {"scheme": "moments", "law": "pi", "start": "2016", "goal": "/etc/passwd"},
     "there are auto"),
    ("camera", {"preset": "../wide"}, "there are wide"),
    ("target", {"name": "poster"}, "there are none now"),
    ("teach", {"name": "../mine"}, "letters, digits"),
    ("teach", {"name": ""}, "letters, digits"),
    ("teach", {"name": "a" * 41}, "40 at most"),
    ("teach", {"name": "a\n"}, "letters, digits"),
])  # fmt: skip
def test_what_is_wrong_is_refused_with_the_reason(do, given, why):
    with pytest.raises(RefusedError) as refused:
        ask(do, **given)
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_long_request_is_not_read_at_all():
    with pytest.raises(RefusedError, match=f"at most {LARGEST} characters"):
        read_request(json.dumps({"do": "start"}) + " " * LARGEST, CHOICES)


@pytest.mark.parametrize("text", [
    "", "start", "[]", '"start"', "{}", '{"do": 1}', "[" * 4000, b"\x00", b'{"do": "start"}',
    '{"do": "start", "x": "' + "a" * LARGEST + '"}',
])  # fmt: skip
def test_what_is_no_request_is_refused(text):
    with pytest.raises(RefusedError):
        read_request(text, CHOICES)


def test_every_request_has_a_use():
    for do, specs in REQUESTS.items():
        assert do.isidentifier() and all(name.isidentifier() for name in specs)


def test_the_pages_keys_are_those_of_the_terminal():
    script = (Path(page.__file__).parent / "page" / "app.js").read_text()
    text = re.search(r"const KEYS = \{(.*?)\};", script, re.DOTALL)[1]
    found = {key: (AXES.index(axis), float(sign))
             for key, axis, sign in re.findall(r'(\w): \["(\w\w)", (-?1)\]', text)}
    assert found == CAMERA_KEYS


OURS = Access("127.0.0.1", 8080, "right-token-here")


@pytest.mark.parametrize(("token", "host", "origin", "why"), [
    ("right-token-here", "127.0.0.1:8080", None, ""),
    ("right-token-here", "localhost:8080", "http://localhost:8080", ""),
    ("right-token-here", "127.0.0.1:8080", "http://127.0.0.1:8080", ""),
    ("", "127.0.0.1:8080", None, "no token"),
    ("right-token-her", "127.0.0.1:8080", None, "not this simulator's"),
    ("right-token-héré", "127.0.0.1:8080", None, "not this simulator's"),
    ("right-token-here", "127.0.0.1:8081", None, "not served under"),
    ("right-token-here", "evil.example:8080", None, "not served under"),
    ("right-token-here", "127.0.0.1.evil.example:8080", None, "not served under"),
    ("right-token-here", "", None, "not served under"),
    ("right-token-here", "127.0.0.1", None, "not served under"),
    ("right-token-here", "127.0.0.1:8080", "http://evil.example", "may not ask here"),
    ("right-token-here", "127.0.0.1:8080", "http://127.0.0.1:9090", "may not ask here"),
    ("right-token-here", "127.0.0.1:8080", "https://127.0.0.1:8080", "may not ask here"),
    ("right-token-here", "127.0.0.1:8080", "null", "may not ask here"),
    ("right-token-here", "127.0.0.1:8080", "http://[::1", "may not ask here"),
])  # fmt: skip
def test_who_may_ask(token, host, origin, why):
    refusal = OURS.refusal(token, host, origin)
    assert (why in refusal) if why else (refusal == "")
    assert "right-token" not in refusal


def test_opened_to_others_addresses_of_digits_are_taken_and_names_are_not():
    access = Access("0.0.0.0", 8080, "right-token-here")
    for host in ("192.168.1.5:8080", "127.0.0.1:8080", "[fe80::1]:8080"):
        assert access.refusal("right-token-here", host, f"http://{host}") == ""
    for host in ("evil.example:8080", "dead.beef:8080x", "192.168.1.5:8081"):
        assert access.refusal("right-token-here", host, None)
    assert Access("lab-pc", 8080, "t" * 12).refusal("t" * 12, "lab-pc:8080", None) == ""


def test_tokens_are_not_to_be_guessed():
    tokens = {Access().token for _ in range(50)}
    assert len(tokens) == 50
    assert min(map(len, tokens)) >= 20
    assert Access().address.startswith("http://127.0.0.1:8080/?token=")
