"""Parameters in the types of their defaults; every fault names the parameter and the mend."""

import math

import pytest

from aras_visual_servo_ros.parameters import InvalidParameterError, converted, nearest, read

DEFAULTS = {"rate": 10.0, "count": 3, "quiet": False, "mode": "fast", "topics": ()}


@pytest.mark.parametrize(
    ("value", "default", "expected"),
    [
        (3, 1.0, 3.0),
        (2.5, 1.0, 2.5),
        (3, 1, 3),
        (True, False, True),
        ("a b", (), ("a", "b")),
        (["a", "b"], (), ("a", "b")),
        ("a b", "", "a b"),
    ],
)
def test_values_come_in_the_type_of_their_default(value, default, expected):
    found = converted("x", value, default)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("value", "default", "mend"),
    [
        (True, 1.0, "give a number"),
        (math.nan, 1.0, "give a finite number"),
        (-math.inf, 1.0, "give a finite number"),
        ("3", 1.0, "give a number"),
        (True, 1, "give a whole number"),
        (1.0, 1, "give a whole number"),
        (1, False, "give true or false"),
        (1, "", "give text"),
        ([1], (), "give a list of texts"),
        (1, (), "give a list of texts"),
    ],
)
def test_nothing_is_bent(value, default, mend):
    with pytest.raises(InvalidParameterError, match=mend) as caught:
        converted("/node/x", value, default)
    assert caught.value.name == "/node/x"
    assert str(caught.value).startswith("/node/x is ")


def test_what_is_given_is_read_and_what_is_others_is_left():
    values = {"rate": 5, "topics": "a", "theirs": 1, "below": {"x": 1}}
    assert read(values, DEFAULTS, "/node", {"theirs"}) == {"rate": 5.0, "topics": ("a",)}


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(InvalidParameterError, match="/node/rat is unknown; did you mean rate"):
        read({"rat": 1.0}, DEFAULTS, "/node")
    with pytest.raises(InvalidParameterError, match="known are rate, count, quiet, mode, topics"):
        read({"xyzzy": 1.0}, DEFAULTS, "/node")
    assert nearest("cuont", DEFAULTS) == "did you mean count?"
