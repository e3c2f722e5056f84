"""Rules of the live page: valid requests. Who may ask: unit/bench/test_page_access.py."""

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from aras_visual_servo_bench.errors import RefusedRequestError
from aras_visual_servo_bench.web.live.page_requests import (
    CHOICE_FIELDS,
    REQUESTS,
    read_request,
)
from aras_visual_servo_bench.web.page_messages import read_message

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
