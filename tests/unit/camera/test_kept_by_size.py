"""Cache of prepared geometry: its memory is limited, not its number of entries."""

from dataclasses import dataclass

from aras_visual_servo_base.memory import ByteLimitedCache


@dataclass
class Made:
    nbytes: int


def keys(recent: ByteLimitedCache, wanted: dict[str, int]) -> list[str]:
    """Those of `wanted` that had to be made."""
    made = []
    for key, size in wanted.items():
        recent.get(key, lambda size=size, key=key: made.append(key) or Made(size))
    return made


def test_those_used_last_stay_and_one_too_large_stays_alone():
    recent: ByteLimitedCache[str, Made] = ByteLimitedCache(100)
    small = {str(n): 1 for n in range(100)}
    assert len(keys(recent, small)) == 100 and keys(recent, small) == []
    assert keys(recent, {"a": 50, "b": 50}) == ["a", "b"]
    assert keys(recent, {"a": 50, "c": 50}) == ["c"]  # b goes, which was used before a
    assert keys(recent, {"a": 50, "b": 50, "large": 101}) == ["b", "large"]
    assert keys(recent, {"large": 101, "a": 50}) == ["a"]
    recent.clear()
    assert keys(recent, {"a": 50}) == ["a"]


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
