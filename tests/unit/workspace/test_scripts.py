"""Shell scripts: options and messages that need no setup."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def run(*command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | environment
    return subprocess.run(
        [str(ROOT / command[0]), *command[1:]], env=env, capture_output=True, text=True, timeout=20
    )


@pytest.mark.parametrize("script", ["setup.sh", "demo.sh", "test.sh"])
def test_help_names_every_option_and_ends_with_an_example(script: str) -> None:
    done = run(script, "--help")
    assert done.returncode == 0
    assert re.search(rf"\nexample: \./{script} \S.*\n\Z", done.stdout)
    options = re.findall(r"^\s+(--\w+)[ |)=]", (ROOT / script).read_text(), re.MULTILINE)
    assert set(options) <= set(re.findall(r"--\w+", done.stdout))


def test_setup_lists_packages_and_refuses_unknown_words() -> None:
    for words, told in ((("--fast",), "unknown option --fast"),
                        (("--for", "fun"), "running demo bench developing")):  # fmt: skip
        done = run("setup.sh", *words)
        assert done.returncode == 1 and told in done.stderr
    packages = [run("setup.sh", *words, "--packages").stdout.split()
                for words in ((), ("--for=running",), ("--for=developing",))]  # fmt: skip
    assert {"catkin", "ros-base", "rviz", "python3-venv"} <= set(packages[0])
    assert set(packages[2]) - set(packages[1]) == {
        "catkin-lint", "liburdfdom-tools", "libegl1", "libgl1-mesa-dri", "python3-angles",
        "chromium-headless-shell", "libjs-katex",
    }  # fmt: skip


def test_requirements_are_pinned() -> None:
    for file in (ROOT / "requirements").glob("*.txt"):
        for line in file.read_text().splitlines():
            plain = not line or line.startswith(("#", "-r "))
            assert plain or re.fullmatch(r"[\w-]+==[\w.]+", line), (file, line)


NODES = [
    node
    for folder in ("aras_sim_bridge/nodes", "aras_visual_servo_camera/nodes",
                   "upstream_names/gazebo_ros/scripts", "upstream_names/controller_manager/scripts")
    for node in sorted((ROOT / "src" / folder).iterdir())
]  # fmt: skip
STARTING = "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(10)"


@pytest.mark.parametrize("node", NODES, ids=lambda node: f"{node.parts[-3]}/{node.name}")
def test_a_node_interrupted_while_it_starts_ends_without_a_traceback(node: Path, tmp_path: Path):
    """What it runs interrupts it when it is imported."""
    module = re.search(r'^run\("([\w.]+)"\)$', node.read_text(), re.MULTILINE).group(1)
    *packages, last = module.split(".")
    folder = tmp_path.joinpath(*packages)
    folder.mkdir(parents=True)
    (folder / f"{last}.py").write_text(STARTING)
    library = ROOT / "src" / "aras_visual_servo_base" / "src"
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{library}"}
    done = subprocess.run([sys.executable, node], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
