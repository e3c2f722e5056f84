"""The tables of docs/scheme_interface.md say what the classes say, all of their fields."""

import dataclasses
import importlib
import sys
from pathlib import Path

import pytest
from blocks import ROOT


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    yield importlib.import_module("scheme_interface")
    sys.modules.pop("scheme_interface")


def test_the_page_is_as_the_script_makes_it(script):
    page = Path(script.PAGE).read_text(encoding="utf-8")
    assert script.filled(page) == page, "run docs/scheme_interface.py"


def test_every_field_of_a_shown_class_is_in_its_table(script):
    page = Path(script.PAGE).read_text(encoding="utf-8")
    shown = script.TABLE.findall(page)
    assert len(shown) == 8
    for _, module, name, _ in shown:
        documented = getattr(importlib.import_module(module), name)
        told = {word for names, _ in script.attributes(documented) for word in names.split(", ")}
        if dataclasses.is_dataclass(documented):
            assert {field.name for field in dataclasses.fields(documented)} - told == set(), name


def test_what_a_docstring_changes_changes_the_page(script):
    class Told:
        """One.

        Attributes (of the class):
            first, second: both,
                in two lines | with a bar.
            third: m.

        Not this: one.
        """

    found = script.attributes(Told)
    assert found == [("first, second", "both, in two lines | with a bar."), ("third", "m.")]
