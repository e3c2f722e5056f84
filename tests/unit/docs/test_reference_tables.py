"""Tables of READMEs and documentation agree with the classes and registries."""

import dataclasses
import importlib
import re
import sys

import pytest
from blocks import ROOT

from aras_visual_servo_controller.records.outcomes import KINDS


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    yield importlib.import_module("reference_tables")
    sys.modules.pop("reference_tables")


def test_the_pages_are_as_the_script_makes_them(script):
    assert len(script.find_pages()) >= 2
    for path in script.find_pages():
        page = path.read_text(encoding="utf-8")
        assert script.fill_tables(page) == page, f"{path}: run docs/reference_tables.py"


def test_every_field_of_a_shown_class_is_in_its_table(script):
    pages = script.find_pages()
    shown = [found for path in pages for found in script.TABLE.findall(path.read_text())]
    assert len(shown) >= 10
    for _, kind, module, name, _ in shown:
        documented = getattr(importlib.import_module(module), name)
        if kind == "fields" and dataclasses.is_dataclass(documented):
            names = {word for names, _ in script.read_attributes(documented)
                     for word in names.split(", ")}  # fmt: skip
            assert {field.name for field in dataclasses.fields(documented)} - names == set(), name


def test_every_outcome_is_explained_on_the_page_of_the_controller():
    page = (ROOT / "src/aras_visual_servo_controller/README.md").read_text(encoding="utf-8")
    table = page.partition("| outcome | when |")[2].partition("\n\n")[0]
    named = {name for row in table.splitlines()[1:] for name in re.findall(
        "`(.+?)`", row.split("|")[1])}  # fmt: skip
    assert set(KINDS) <= named
