"""Every code block of the documentation works; none is left out."""

from __future__ import annotations

import dataclasses
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from blocks import PAGES, ROOT, Block, blocks
from commands import CHECKS, check
from given import GIVEN

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.control.controllers.registry import ControllerTypes
from aras_visual_servo_bench.cli import main as bench
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_execution import check_study
from aras_visual_servo_controller.settings import ControllerSettings

LANGUAGES = {"python", "yaml", "bash", "text", "xml"}
# By page, what is executed instead of the text of a block, so that it takes less time.
SHORTER = {"docs/studies.md": ("repeats=10", "repeats=2")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page(page: Path, tmp_path, monkeypatch):
    """From the first to the last, in one folder and with what those before have made."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    modules = set(sys.modules)
    names: dict[str, Any] = {"__name__": "page"}
    try:
        for block in blocks(page):
            try:
                carry_out(block, tmp_path, names)
            except (Exception, pytest.fail.Exception) as error:
                pytest.fail(f"{block.place}: {type(error).__name__}: {error}\n\n{block.text}")
    finally:
        for name in set(sys.modules) - modules:  # what the page wrote is not another page's
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
                del sys.modules[name]


def carry_out(block: Block, folder: Path, names: dict[str, Any]) -> None:
    if not block.fenced:
        first = {line.split()[0] for line in block.text.splitlines() if line.strip()}
        assert not first & set(CHECKS), "a command stands in a block with ```bash around it"
        return
    assert block.language in LANGUAGES, f"a block is one of {LANGUAGES}, not '{block.language}'"
    if block.file:
        path = folder / block.file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text)
        if path.suffix == ".py":
            monkeypatched_path(path.parent)
    if block.language == "python":
        for name in block.mark.removeprefix("given ").split(", ") if block.mark else ():
            names.update(GIVEN[name]())
        text = block.text.replace(*SHORTER.get(str(block.page.relative_to(ROOT)), ("", "")))
        code = compile(text, block.place, "exec", dont_inherit=True)
        # a file is what other blocks import: its classes come from there
        exec(code, {"__name__": Path(block.file).stem} if block.file else names)
    elif block.language == "yaml":
        load(yaml.safe_load(block.text))
    elif block.language == "xml":
        ElementTree.fromstring(block.text)
    elif block.language == "bash":
        for words in block.commands():
            if block.mark.startswith("run with"):
                run(words, block.mark.removeprefix("run with").split())
            else:
                check(words, folder)
    else:
        first = {line.split()[0] for line in block.text.splitlines() if line.strip()}
        assert not first & set(CHECKS), "a command stands in a block with ```bash around it"


def monkeypatched_path(folder: Path) -> None:
    """Make a page's own modules importable; the test of the page restores the path."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


def run(words: list[str], more: list[str]) -> None:
    """A command of the bench's, carried out."""
    assert words[:3] == ["rosrun", "aras_visual_servo_bench", "bench"], words
    assert bench([*words[3:], *more]) == 0


def load(tree: Mapping[str, Any]) -> None:
    """Load a YAML tree with the reader that its keys determine."""
    keys = set(tree)
    fields = {field.name for field in dataclasses.fields(Experiment)}
    if "experiment" in keys:
        check_study(Study.from_mapping(tree))
    elif keys == {"class", "arguments", "workers"}:
        assert "." in tree["class"]
    elif keys <= fields:
        Experiment.from_mapping(tree)
    elif keys <= {field.name for field in dataclasses.fields(ControllerSettings)}:
        ControllerSettings.from_mapping(tree)
    elif all(isinstance(value, Mapping) for value in tree.values()):
        for entry in tree.values():
            group(entry)
    else:
        CameraConfig.from_mapping({"name": "camera", **tree})


def group(entry: Mapping[str, Any]) -> None:
    """A camera of the world, a controller, or a namespace of controllers."""
    if "type" in entry:
        ControllerTypes().find(entry["type"])
    elif "parent" in entry:
        settings = {k: v for k, v in entry.items() if k not in ("parent", "pose")}
        CameraConfig.from_mapping({"name": "camera", **settings})
    else:
        for value in entry.values():
            group(value)


def test_a_block_that_nothing_covers_fails(tmp_path):
    def of(text: str, language: str, fenced: bool = True) -> Block:
        return Block(ROOT / "README.md", 1, language, text, fenced=fenced)

    wrong = [
        of("x = 1", ""), of("int x;", "cpp"), of("no_such_program --fast", "bash"),
        of("roslaunch a b.launch", "text"), of("rosrun a b", "", fenced=False),
        of("roslaunch aras_visual_servo_gazebo aras_visual_servo.launch cammera:=wide", "bash"),
        of("roslaunch aras_visual_servo_gazebo aras_visual_servo_nodes.launch scheme:=x", "bash"),
        of("rosrun aras_visual_servo_bench bench run a.yaml --ouut b", "bash"),
        of("rosrun aras_visual_servo_bench no_such_tool", "bash"),
        of("./demo.sh --scheme", "bash"), of("./setup.sh --for nobody", "bash"),
        of("python3 tests/benchmarks/no_such.py", "bash"), of("plant: bulet", "yaml"),
        of("docker compose -f docker/compose.yaml run --rm nothing", "bash"),
        of("raise ValueError", "python"), of("<robot>", "xml"),
    ]  # fmt: skip
    for block in wrong:
        with pytest.raises((Exception, pytest.fail.Exception, SystemExit)):
            carry_out(block, tmp_path, {})
            print("taken:", block.text)
