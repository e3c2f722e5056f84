"""Compiled functions work where they cannot be kept, and say so."""

import logging

import numba
import numpy as np

from aras_visual_servo_camera import compiled


def test_without_a_place_to_keep_them_functions_work_all_the_same(monkeypatch, caplog):
    njit = numba.njit

    def no_place(types, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function 'total': no locator available for file 'x'")
        return njit(types, **options)

    monkeypatch.setattr(numba, "njit", no_place)
    compiled._tell_once.cache_clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            total = compiled.compiled(compiled.VECTOR)(lambda x: x.sum())
            assert total(np.arange(4.0)) == 6.0
    (record,) = caplog.records
    assert "NUMBA_CACHE_DIR" in record.message


def test_other_types_are_refused_instead_of_compiled_in_the_middle_of_a_run():
    total = compiled.compiled(compiled.VECTOR)(lambda x: x.sum())
    assert total(np.arange(8.0)[::2]) == 12.0
    for other in (np.arange(4), np.zeros((2, 2))):
        try:
            total(other)
        except TypeError:
            continue
        raise AssertionError(f"{other.dtype} {other.shape} was taken")
