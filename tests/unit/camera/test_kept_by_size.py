"""Cache of prepared geometry: its memory is limited, not its number of entries."""

from dataclasses import dataclass

from aras_visual_servo_base.memory import ByteLimitedCache


@dataclass
class Made:
    nbytes: int


def keys(recent: ByteLimitedCache, wanted: dict[str, int]) -> list[str]:
    """Return the entries of `wanted` that had to be made."""
    made = []
    for key, size in wanted.items():
        recent.get(key, lambda size=size, key=key: made.append(key) or Made(size))
    return made


def test_any_number_of_small_ones_stay_and_come_again_as_they_are():
    recent: ByteLimitedCache[str, Made] = ByteLimitedCache(1000)
    small = {str(n): 1 for n in range(1000)}
    assert len(keys(recent, small)) == 1000
    assert keys(recent, small) == []


def test_of_large_ones_those_used_last_stay():
    recent: ByteLimitedCache[str, Made] = ByteLimitedCache(100)
    assert keys(recent, {"a": 50, "b": 50}) == ["a", "b"]
    assert keys(recent, {"a": 50, "c": 50}) == ["c"]  # b goes, which was used before a
    assert keys(recent, {"a": 50, "b": 50}) == ["b"]


def test_one_that_is_larger_than_all_room_is_kept_alone():
    recent: ByteLimitedCache[str, Made] = ByteLimitedCache(100)
    assert keys(recent, {"a": 1, "large": 101}) == ["a", "large"]
    assert keys(recent, {"large": 101}) == []
    assert keys(recent, {"a": 1}) == ["a"]
    assert keys(recent, {"large": 101}) == ["large"]


def test_nothing_is_kept_of_a_closed_renderer():
    recent: ByteLimitedCache[str, Made] = ByteLimitedCache(100)
    keys(recent, {"a": 1})
    recent.clear()
    assert keys(recent, {"a": 1}) == ["a"]


def test_every_value_that_the_cache_does_not_keep_is_dropped():
    dropped: list[int] = []
    recent: ByteLimitedCache[str, Made] = ByteLimitedCache(
        100, drop=lambda made: dropped.append(made.nbytes)
    )
    recent.get("a", lambda: Made(60))
    recent.get("b", lambda: Made(50))
    assert dropped == [60]
    # another thread makes the same value at the same time, and is faster
    assert recent.get("c", lambda: recent.get("c", lambda: Made(1)) and Made(2)).nbytes == 1
    assert dropped == [60, 2]
    recent.clear()
    assert dropped == [60, 2, 50, 1]
