"""Names that are imported when they are first used."""

from __future__ import annotations

import importlib
import sys

import pytest

from aras_visual_servo_base.lazy import LazyClasses, lazy_exports
from aras_visual_servo_controller.features import FEATURES
from aras_visual_servo_controller.laws import LAWS
from aras_visual_servo_controller.schemes import SCHEMES

# Features of these keys are named by their class as they are by their key.
NAMED_BY_KEY = sorted(set(FEATURES) - {"moments", "kernel", "points"})


def test_a_class_is_imported_when_it_is_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    known = LazyClasses("email", {"message": ".message:Message", "none": ".nowhere:Nothing"})
    monkeypatch.delitem(sys.modules, "email.message", raising=False)
    assert "message" in known and list(known) == ["message", "none"] and len(known) == 2
    assert "email.message" not in sys.modules and "other" not in known
    assert known["message"].__name__ == "Message" and "email.message" in sys.modules
    with pytest.raises(KeyError):
        known["other"]
    with pytest.raises(ModuleNotFoundError):
        known["none"]


def test_tables_of_two_packages_are_one() -> None:
    both = LazyClasses("email", {"a": ".message:Message"}) | LazyClasses(
        "json", {"b": ".decoder:JSONDecoder"}
    )
    assert [cls.__name__ for cls in both.values()] == ["Message", "JSONDecoder"]


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


def test_every_entry_of_a_registry_is_a_class() -> None:
    for table in (FEATURES, LAWS, SCHEMES):
        assert all(isinstance(cls, type) for cls in table.values())


@pytest.mark.parametrize("name", NAMED_BY_KEY)
def test_a_feature_has_the_name_that_finds_it(name: str) -> None:
    assert FEATURES[name].name == name
