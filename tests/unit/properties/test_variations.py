"""Random settings of a study: in range, each value once, equal on every machine."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.studies.variations import (
    SOBOL_BLOCK,
    VariationAxis,
    draw_values,
    parse_variation,
)

ENDS = st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)).map(lambda t: (t[0], t[0] + t[1]))
DRAWS = {
    "uniform": ENDS,
    "loguniform": st.tuples(st.floats(1e-6, 10.0), st.floats(1.5, 1e4)).map(
        lambda t: (t[0], t[0] * t[1])),
    "integers": st.tuples(st.integers(-9, 9), st.integers(1, 9)).map(lambda t: (t[0], t[0] + t[1])),
}  # fmt: skip


@given(st.sampled_from(sorted(DRAWS)), st.data(), st.sampled_from(["random", "sobol"]),
       st.integers(0, 2**31), st.integers(0, 3 * SOBOL_BLOCK))  # fmt: skip
def test_a_number_is_drawn_from_its_range(kind, data, sampling, entropy, sample):
    low, high = data.draw(DRAWS[kind])
    draw = parse_variation("gain", {kind: [low, high]})
    found = draw_values([draw], sampling, entropy, sample)["gain"]
    assert low - 1e-9 * abs(low) <= found <= high + 1e-9 * abs(high)
    assert (type(found) is int) == (kind == "integers")
    assert draw_values([draw], sampling, entropy, sample) == {"gain": found}
    assert draw.value(0.0) == pytest.approx(low) and draw.value(1.0) == pytest.approx(high)
    assert draw.ends == (low, high)


@settings(max_examples=12)
@given(st.integers(0, 2**31), st.integers(1, 4), st.integers(0, 4))
def test_sobol_points_are_spread_and_never_come_again(entropy, dimensions, part):
    """Of 256 in a row each lies in a stratum of its own, over the ends of blocks too."""
    draws = [parse_variation(f"k{d}", {"uniform": [0.0, 1.0]}) for d in range(dimensions)]
    first = 256 * (part + 1)
    points = np.array([
        list(draw_values(draws, "sobol", entropy, first + k).values()) for k in range(256)
    ])
    for column in points.T:
        assert sorted((256 * column).astype(int)) == list(range(256))
    later = draw_values(draws, "sobol", entropy, first + 2 * SOBOL_BLOCK)
    assert not any(np.allclose(list(later.values()), point, atol=1e-12) for point in points)


def test_distributions_are_those_of_scipy():
    """Though Sobol's points may begin at 0, a normal ends somewhere: what is less often than 1e-12
    is not drawn."""
    for kind, ends, of in (("uniform", [0.01, 0.03], stats.uniform(0.01, 0.02)),
                           ("loguniform", [0.5, 8.0], stats.loguniform(0.5, 8.0)),
                           ("normal", [3.0, 0.5], stats.norm(3.0, 0.5))):  # fmt: skip
        draw = parse_variation("gain", {kind: ends})
        for u in (0.01, 0.3, 0.5, 0.99):
            assert draw.value(u) == pytest.approx(of.ppf(u))
    assert draw.value(0.0) == pytest.approx(3.0 - 0.5 * 7.03, abs=0.01)


@given(st.integers(0, 2**31), st.integers(1, 8), st.integers(0, 500), st.integers(0, 500))
def test_samples_and_keys_are_drawn_apart(entropy, count, one, other):
    draws = [parse_variation(f"k{d}", {"uniform": [0.0, 1.0]}) for d in range(count)]
    found = draw_values(draws, "random", entropy, one)
    assert list(found) == [draw.key for draw in draws]
    assert len(set(found.values())) == count
    if one != other:
        assert set(found.values()).isdisjoint(draw_values(draws, "random", entropy, other).values())


@settings(max_examples=25)
@given(st.lists(st.text(max_size=3), min_size=1, max_size=7), st.floats(0.0, 1.0))
def test_a_choice_is_one_of_its_values_and_each_has_its_share(values, u):
    draw = parse_variation("scheme", {"choice": values})
    assert draw.value(u) == values[min(int(u * len(values)), len(values) - 1)]
    assert draw.value(1.0) == values[-1]
    shares = [draw.value((k + 0.5) / len(values)) for k in range(len(values))]
    assert shares == values


@given(st.sampled_from(["linear", "log"]), st.floats(0.01, 50.0), st.floats(0.01, 50.0),
       st.integers(2, 40))  # fmt: skip
def test_spacings_are_even(kind, first, last, count):
    axis = parse_variation("gain", {kind: [first, last, count]})
    values = np.array(axis.values)
    assert isinstance(axis, VariationAxis) and len(values) == count
    assert (values[0], values[-1]) == pytest.approx((first, last))
    steps = np.diff(values if kind == "linear" else np.log(values))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6, atol=1e-9)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
        st.sampled_from(["linear", "log", "uniform", "normal", "choice", "integers", "x"]), inner,
        max_size=2),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=100)
@given(JUNK)
def test_whatever_is_written_there_is_a_variation_or_one_line_that_names_it(junk):
    try:
        found = parse_variation("some.key", junk)
    except StudyError as error:
        assert "vary.some.key" in str(error) and "\n" not in str(error)
        return
    if not isinstance(found, VariationAxis):
        value = found.value(0.25)
        assert not isinstance(value, float) or math.isfinite(value) or "choice" in junk
