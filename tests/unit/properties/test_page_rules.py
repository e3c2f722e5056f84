"""Rules of the live page: access and valid requests."""

import json

from hypothesis import example, given, settings
from hypothesis import strategies as st

from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.web.access import Access
from aras_visual_servo_bench.web.live.page_requests import (
    CHOICE_FIELDS,
    REQUESTS,
    read_request,
)
from aras_visual_servo_bench.web.page_messages import read_message

NAMES = st.sampled_from([
    "127.0.0.1", "localhost", "LOCALHOST", "[::1]", "192.168.1.7", "evil.example", "127.0.0.1.evil",
    "[fe80::1%eth0]", "0.0.0.0", "127.0.0.2", "localhost.", "2130706433", "user@127.0.0.1",
]) | st.text(max_size=8)  # fmt: skip
PORTS = st.sampled_from(["", ":8080", ":80", ":8081", ":08080", ":", ":8080:8080", ":8080/", ":-1"])
HOSTS = st.builds(str.__add__, NAMES, PORTS)
LOCAL = {name + ":8080" for name in ("127.0.0.1", "localhost", "LOCALHOST")} | {
    "127.0.0.1:08080", "localhost:08080", "LOCALHOST:08080"}  # fmt: skip


@settings(max_examples=120)
@given(HOSTS, st.none() | HOSTS.map("http://".__add__) | HOSTS | HOSTS.map("https://".__add__),
       st.sampled_from(["right", "", "rihgt", "Right", "right ", "réght"]))  # fmt: skip
@example("127.0.0.1:8080", None, "right")
@example("localhost:8080", "http://localhost:8080", "right")
@example("127.0.0.1:8080", "http://evil.example:8080", "right")
def test_who_is_answered_has_the_token_and_this_machine_s_name(host, origin, token):
    access = Access("127.0.0.1", 8080, "right")
    own = origin is None or origin.startswith("http://") and origin[7:] in LOCAL
    assert (access.refusal_reason(token, host, origin) == "") == (
        token == "right" and host in LOCAL and own)


@given(HOSTS)
def test_where_all_may_come_in_no_foreign_name_does(host):
    """Addresses alone, and this machine's own name."""
    answered = Access("0.0.0.0", 8080, "right").refusal_reason("right", host, None) == ""
    name = host.rpartition(":")[0]
    if answered:
        assert name.lower() == "localhost" or "." in name or name.startswith("[")
        assert "evil" not in host and "@" not in host


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner,
                                                                max_size=3),
    max_leaves=6,
)  # fmt: skip
FIELDS = sorted({name for kind in REQUESTS.values() for name in kind.__dataclass_fields__})
CHOICES = {
    kind: ("moments", "2015") for chosen in CHOICE_FIELDS.values() for kind in chosen.values()
}


@settings(max_examples=250)
@given(st.sampled_from([*REQUESTS, "rm", ""]) | st.text(max_size=5),
       st.dictionaries(st.sampled_from(FIELDS), JUNK | st.floats(-0.1, 0.1)
                       | st.just("moments") | st.integers(1, 9), max_size=6))  # fmt: skip
def test_what_is_carried_out_was_asked_for_within_its_bounds(do, fields):
    try:
        asked, given_fields = read_message(json.dumps({"do": do, **fields}), REQUESTS)
        request = read_request(asked, given_fields, CHOICES)
    except RefusedRequestError as error:
        assert "\n" not in str(error) and len(str(error)) < 400
        return
    assert request.do == do in REQUESTS
    for name, value in request.arguments.items():
        rules = REQUESTS[do].__dataclass_fields__[name].metadata
        if isinstance(value, float):
            assert rules["least"] <= value <= rules["most"]
        if name in CHOICE_FIELDS.get(do, {}):
            assert value in ("moments", "2015")


@given(st.text(max_size=40) | st.binary(max_size=10))
def test_what_is_no_request_is_refused(text):
    try:
        do, _ = read_message(text, REQUESTS)
    except RefusedRequestError as error:
        assert "\n" not in str(error)
    else:
        assert do in REQUESTS
