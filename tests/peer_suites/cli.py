"""Run upstream's test suites with this workspace: which tests pass, fail or cannot apply.

The sources are the user's (noetic-devel of ros_control, ros_controllers and gazebo_ros_pkgs), and
so is what their build left in lib/<package>: nothing of it is kept here. Suites whose hardware is
a program of their own get ours in its place (stand_ins/).
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import page
import rospkg
import yaml

HERE = Path(__file__).resolve().parent
LIMIT = 400.0  # s of wall time a suite; upstream's longest has 260
WAIT = """#!/bin/sh
until rosservice list 2>/dev/null | grep -qx {service}; do sleep 0.2; done
exec {program} "$@"
"""


@dataclass(frozen=True)
class Suite:
    """Launch file with tests; see suites.yaml."""

    package: str
    test: str
    stand_ins: Sequence[str] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    ready: str = ""
    not_applicable: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """<package>/<name of the launch file without its ending>."""
        return f"{self.package}/{Path(self.test).stem}"


@dataclass(frozen=True)
class Tried:
    """Result of a suite: the names of its tests, and the reasons of failures."""

    suite: Suite
    passed: tuple[str, ...] = ()
    failed: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""  # why it could not be run at all

    @property
    def counted(self) -> dict[str, str]:
        return {k: why for k, why in self.failed.items() if k not in self.suite.not_applicable}


def suites(file: Path = HERE / "suites.yaml") -> list[Suite]:
    return [Suite(**row) for row in yaml.safe_load(file.read_text())]


def packages(sources: Path) -> dict[str, Path]:
    found = {}
    for file in sorted(sources.rglob("package.xml")):
        name = ElementTree.parse(file).findtext("name")
        if name:
            found.setdefault(name.strip(), file.parent)
    return found


def run(suite: Suite, folder: Path, sources: Path, built: Path, keep: Path) -> Tried:
    if not (folder / suite.test).is_file():
        return Tried(suite, problem=f"no {suite.test} in {folder}")
    shutil.rmtree(keep, ignore_errors=True)
    prefix = keep / "prefix"
    programs = prefix / "lib" / suite.package
    programs.mkdir(parents=True)
    (prefix / ".catkin").touch()
    made = built / "lib" / suite.package
    theirs = {p.name: p for p in (made.iterdir() if made.is_dir() else ())}
    ours = {name: HERE / "stand_ins" / name for name in suite.stand_ins}
    for name, program in {**theirs, **ours}.items():
        (programs / name).symlink_to(program)
    if suite.ready:  # a simulation takes some seconds more than upstream's C++ to be up
        tests = ElementTree.parse(folder / suite.test).iter("test")
        for name in {str(test.get("type")) for test in tests}:
            program = theirs.get(name) or next((folder / "test").rglob(name), None)
            if program is None:
                return Tried(suite, problem=f"{name} is neither in {made} nor in {folder}/test")
            (programs / name).unlink(missing_ok=True)
            (programs / name).write_text(WAIT.format(service=suite.ready, program=program))
            (programs / name).chmod(0o755)
    path = f"{os.environ['ROS_PACKAGE_PATH']}:{sources}"
    here = rospkg.RosPack()
    if suite.package in here.list():  # a package that both have: ours, with the tests of theirs
        both = keep / "packages" / suite.package
        both.mkdir(parents=True)
        for entry in [*Path(here.get_path(suite.package)).iterdir(), folder / "test"]:
            (both / entry.name).symlink_to(entry)
        path = f"{both.parent}:{path}"
    launch = keep / "suite.test"
    # The bridge's time is simulated, and a test's node asks for it before the bridge could say so.
    parameters = {"/use_sim_time": True, **suite.parameters}
    lines = [f'<param name="{name}" value="{value}"/>' for name, value in parameters.items()]
    launch.write_text(f'<launch>{"".join(lines)}<include file="{folder / suite.test}"/></launch>\n')
    environment = dict(
        os.environ,
        CMAKE_PREFIX_PATH=f"{prefix}:{os.environ['CMAKE_PREFIX_PATH']}",
        ROS_PACKAGE_PATH=path,
        PYTHONPATH=f"{HERE / 'shims'}:{HERE}:{folder / 'src'}:{os.environ['PYTHONPATH']}",
        ROS_HOME=str(keep), ROS_TEST_RESULTS_DIR=str(keep / "results"), ROS_IP="127.0.0.1",
    )
    asked = ["rostest", "--package", suite.package, "--pkgdir", str(folder), str(launch)]
    with (keep / "output").open("wb") as output:
        started = subprocess.Popen(asked, env=environment, stdout=output,
                                   stderr=subprocess.STDOUT, start_new_session=True)
        try:
            started.wait(LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(started.pid, signal.SIGINT)
            started.wait(30)
            return Tried(suite, problem=f"not done after {LIMIT:.0f} s")
    files = sorted((keep / "results").rglob("*.xml"))
    # rostest's own file says of each test program only whether it left one.
    passed, failed = read(file for file in files if not file.name.startswith("rostest-"))
    if not passed and not failed:
        _, faults = read(files)
        why = "; ".join(faults.values()) or "it left no results"
        return Tried(suite, problem=f"{why}: see {keep / 'output'}")
    return Tried(suite, tuple(passed), failed)


def read(files: Iterable[Path]) -> tuple[list[str], dict[str, str]]:
    """Read JUnit files; return passed tests, and failed tests with the start of their messages."""
    passed, failed = [], {}
    for file in files:
        try:
            root = ElementTree.parse(file).getroot()
        except ElementTree.ParseError:
            failed[file.stem] = "its results are broken off"
            continue
        for case in root.iter("testcase"):
            name = f"{case.get('classname', '').split('.')[-1]}.{case.get('name', '')}"
            faults = [*case.iter("failure"), *case.iter("error")]
            if faults:
                words = faults[0].get("message") or faults[0].text or ""
                failed[name] = " ".join(words.split())[:160]
            else:
                passed.append(name)
    return passed, failed


def table(tried: Sequence[Tried], commits: Mapping[str, str]) -> str:
    """Return the table of docs/porting.md."""
    lines = ["| suite | passed | failed | not applicable |", "|---|---|---|---|"]
    for one in tried:
        apart = {k: why for k, why in one.suite.not_applicable.items() if k in one.failed}
        failed = one.problem or "; ".join([str(len(one.counted)), *one.counted])
        reasons = sorted(set(apart.values()))
        given = ", ".join(f"`{key}:={value}`" for key, value in one.suite.parameters.items())
        name = f"{one.suite.name} with {given}" if given else one.suite.name
        lines.append(f"| {name} | {len(one.passed)} | {failed} "
                     f"| {'; '.join([str(len(apart)), *reasons])} |")
    of = ", ".join(f"{name} {commit[:12]}" for name, commit in sorted(commits.items()))
    return "\n".join([*lines, "", f"Sources: {of or 'without commits'}."])


def commits_in(sources: Path) -> dict[str, str]:
    found = {}
    for folder in sorted(p for p in sources.iterdir() if (p / ".git").exists()):
        said = subprocess.run(["git", "-C", str(folder), "rev-parse", "HEAD"],
                              capture_output=True, text=True, check=False)
        if said.returncode == 0:
            found[folder.name] = said.stdout.strip()
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="tests/peers", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter,
                                     epilog="example: tests/peers ~/peers/src ~/peers/devel")
    parser.add_argument("sources", type=Path, help="folder with checkouts of the repositories")
    parser.add_argument("built", type=Path, help="devel or install space of their build")
    parser.add_argument("--only", default="", help="suites whose name has this regular expression")
    parser.add_argument("--keep", type=Path, help="folder of logs and results (a temporary one)")
    parser.add_argument("--write", type=Path, help="put the table into this page")
    asked = parser.parse_args(arguments)
    for folder in (asked.sources, asked.built):
        if not folder.is_dir():
            parser.error(f"there is no folder {folder}")
    if shutil.which("rostest") is None:
        parser.error("there is no command rostest: apt install python3-rostest")
    sources, built = asked.sources.resolve(), asked.built.resolve()
    known, keep = packages(sources), (asked.keep or Path(tempfile.mkdtemp(prefix="peers-")))
    tried = []
    for suite in suites():
        if not re.search(asked.only, suite.name):
            continue
        if suite.package in known:
            one = run(suite, known[suite.package], sources, built, keep.resolve() / suite.name)
        else:
            one = Tried(suite, problem=f"no package {suite.package} in {sources}")
        tried.append(one)
        print(f"{suite.name}: {one.problem or f'{len(one.passed)} passed'}", flush=True)
        for name, why in one.failed.items():
            apart = suite.not_applicable.get(name)
            print(f"  {'not applicable' if apart else 'FAILED'} {name}: {apart or why}")
    text = table(tried, commits_in(sources))
    if asked.write:
        page.write(asked.write, "peers", text)
    print(f"{text}\n\nlogs in {keep}")
    return 1 if any(one.problem or one.counted for one in tried) else 0


if __name__ == "__main__":
    sys.exit(main())
