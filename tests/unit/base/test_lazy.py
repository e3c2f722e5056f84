"""Names that are imported when they are first used."""

from __future__ import annotations

import importlib

import pytest

from aras_visual_servo_base.lazy import lazy_exports


def test_a_package_exports_names_of_its_modules() -> None:
    exported = lazy_exports("json", {"JSONDecoder": ".decoder"})
    assert exported("JSONDecoder") is importlib.import_module("json.decoder").JSONDecoder
    with pytest.raises(AttributeError, match="module 'json' has no attribute 'Other'"):
        exported("Other")


@pytest.mark.parametrize("package", [
    "aras_sim_bridge.camera", "aras_sim_bridge.description", "aras_sim_bridge.rendering",
    "aras_visual_servo_controller.laws",
])  # fmt: skip
def test_all_that_a_package_says_it_exports_is_there(package: str) -> None:
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None
