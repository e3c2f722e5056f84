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
# By page, texts of blocks and what is executed instead, so that it takes less time.
HOLD = ("Experiment(", 'Experiment(controller_parameters={"hold": 0.3}, ')  # of other pages
SHORTER = {
    "docs/my_camera.md": (HOLD, ("width: 640\nheight: 480", "width: 160\nheight: 120")),
    "docs/my_target.md": (
        HOLD, ('plant="free"', 'plant="free", gain=4.0'), ("duration=4.0", "duration=1.0")),
    "docs/reading_results.md": (HOLD, ('report("mine")', 'report("mine", kinds=())')),
    "docs/several_cameras.md": (
        ("\ngain: 2.0", "\ngain: 4.0\ncontroller_parameters: {hold: 0.3}"),
        ('.yaml")\nfor',
         '.yaml").with_changes(gain=4.0, controller_parameters={"hold": 0.3})\nfor')),
    "docs/solid_targets.md": (
        ('scheme="model"', 'scheme="model", gain=4.0, controller_parameters={"hold": 0.3}'),
        ("=rough)", '=rough | {"hold": 0.3}, gain=4.0)'),
        ('"label"}}, gain=2.0', '"label"}, "hold": 0.3}, gain=4.0')),
    "docs/studies.md": (("repeats=10", "repeats=2"),),
}  # fmt: skip


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page(page: Path, tmp_path, monkeypatch):
    """From the first to the last, in one folder and with what those before have made."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    modules = set(sys.modules)
    names: dict[str, Any] = {"__name__": "page"}
    shorter = SHORTER.get(str(page.relative_to(ROOT)), (HOLD,))
    assert shorter == (HOLD,) or all(old in page.read_text("utf-8") for old, _ in shorter)
    try:
        for block in blocks(page):
            for change in shorter:
                block = dataclasses.replace(block, text=block.text.replace(*change))
            try:
                carry_out(block, tmp_path, names)
            except (Exception, pytest.fail.Exception) as error:
                pytest.fail(f"{block.place}: {type(error).__name__}: {error}\n\n{block.text}")
    finally:
        for name in set(sys.modules) - modules:  # what the page wrote is not another page's
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
                del sys.modules[name]


def carry_out(block: Block, folder: Path, names: dict[str, Any]) -> None:
    if block.fenced:
        known = f"a block is one of {LANGUAGES}, not '{block.language}'"
        assert block.language in LANGUAGES, known
    if not block.fenced or block.language == "text":
        first = {line.split()[0] for line in block.text.splitlines() if line.strip()}
        assert not first & set(CHECKS), "a command stands in a block with ```bash around it"
        return
    if block.file:
        path = folder / block.file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text)
        if path.suffix == ".py" and str(path.parent) not in sys.path:
            sys.path.insert(0, str(path.parent))  # the test of the page restores it
    if block.language == "python":
        for name in block.mark.removeprefix("given ").split(", ") if block.mark else ():
            names.update(GIVEN[name]())
        code = compile(block.text, block.place, "exec", dont_inherit=True)
        # a file is what other blocks import: its classes come from there
        exec(code, {"__name__": Path(block.file).stem} if block.file else names)
    elif block.language == "yaml":
        load(yaml.safe_load(block.text))
    elif block.language == "xml":
        ElementTree.fromstring(block.text)
    else:
        for words in block.commands():
            if block.mark.startswith("run with"):
                assert words[:3] == ["rosrun", "aras_visual_servo_bench", "bench"], words
                assert bench([*words[3:], *block.mark.removeprefix("run with").split()]) == 0
            else:
                check(words, folder)


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
