"""Run public Gazebo packages unchanged with this workspace, and report which parts work.

The repositories are the user's checkouts below one folder (`--clone` prints the commands that make
them). Each row of packages.yaml is launched without a window on a master of its own; probe.py then
commands its controllers and looks at its topics and services. A part that is not served has to be
named in exactly one line of the log.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import page
import yaml

HERE = Path(__file__).resolve().parent
MARK = "packages"
START = 90.0  # s of wall time until models and controllers have to be there; a row may change it
PROBE = 240.0  # s of wall time for all that probe.py looks at


@dataclass(frozen=True)
class Package:
    """A launch of a public package; see packages.yaml.

    repositories: commit by owner/name. folders: of packages, below the checkouts; all if empty.
    launch: words of the roslaunch command. environment: variables. In both, {sources} is the folder
    of the checkouts. models, controllers, topics, services, attach: what has to work. remapped:
    command topics to which the package gives other names. not_served: what the log has to name,
    once each.
    """

    name: str
    repositories: Mapping[str, str]
    launch: str
    folders: Sequence[str] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    models: Sequence[str] = ()
    controllers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    topics: Sequence[str] = ()
    services: Sequence[str] = ()
    attach: Sequence[str] = ()
    remapped: Mapping[str, str] = field(default_factory=dict)
    not_served: Sequence[str] = ()
    start: float = START


@dataclass(frozen=True)
class Result:
    """Result of a launch: working parts, faults, and the simulator's warnings."""

    package: Package
    works: Sequence[str] = ()
    faults: Sequence[str] = ()
    warnings: Sequence[str] = ()


def known_packages(file: Path) -> list[Package]:
    return [Package(**row) for row in yaml.safe_load(file.read_text())]


def clone_commands(packages: Sequence[Package]) -> list[str]:
    """Return shell commands that clone each repository once into the current folder."""
    commits = {repo: commit for one in packages for repo, commit in one.repositories.items()}
    return [f"git clone https://github.com/{repo} && git -C {repo.partition('/')[2]} checkout "
            f"{commit}" for repo, commit in sorted(commits.items())]


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def environment_of(package: Package, sources: Path, keep: Path, port: int) -> dict[str, str]:
    """Return the environment of a launch: the package's folders first, and no display."""
    checkouts = [sources / repo.partition("/")[2] for repo in package.repositories]
    folders = [sources / folder for folder in package.folders] or checkouts
    modules = [file.parent / "src" for folder in folders for file in folder.rglob("setup.py")
               if (file.parent / "package.xml").is_file()]
    environment = dict(
        os.environ,
        ROS_PACKAGE_PATH=":".join([*map(str, folders), os.environ["ROS_PACKAGE_PATH"]]),
        PYTHONPATH=":".join([*map(str, modules), os.environ["PYTHONPATH"]]),
        ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1", ROS_HOME=str(keep),
        ROS_LOG_DIR=str(keep / "log"), ROSCONSOLE_FORMAT="[${severity}] [${node}] ${message}",
        PYTHONUNBUFFERED="1",
    )
    environment.pop("DISPLAY", None)
    for name, value in package.environment.items():
        environment[name] = value.format(sources=sources)
    return environment


def run(package: Package, sources: Path, keep: Path) -> Result:
    for repo in package.repositories:
        if not (sources / repo.partition("/")[2]).is_dir():
            return Result(package, faults=[f"no checkout of {repo} in {sources}"])
    shutil.rmtree(keep, ignore_errors=True)
    keep.mkdir(parents=True)
    port = free_port()
    environment = environment_of(package, sources, keep, port)
    log = keep / "output"
    with log.open("wb") as output:
        words = package.launch.format(sources=sources).split()
        launched = subprocess.Popen(
            ["roslaunch", "-p", str(port), *words], env=environment,
            stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            start_new_session=True)
        try:
            works, faults = probe(package, launched, environment, keep)
        finally:
            stop(launched)
    lines = plain_lines(log)
    return Result(package, works, [*faults, *unnamed(package, lines)], warnings_of(lines))


def probe(package: Package, launched: subprocess.Popen, environment: Mapping[str, str],
          keep: Path) -> tuple[list[str], list[str]]:
    wanted = {name: getattr(package, name)
              for name in ("models", "controllers", "topics", "services", "attach", "remapped",
                            "start")}
    with (keep / "probe").open("wb") as output:
        looking = subprocess.Popen([sys.executable, str(HERE / "probe.py"), json.dumps(wanted)],
                                   env=environment, stdout=subprocess.PIPE, stderr=output)
        deadline = time.monotonic() + package.start + PROBE
        while looking.poll() is None:
            if launched.poll() is not None or time.monotonic() > deadline:
                looking.kill()
                looking.wait()
                ended = launched.poll() is not None
                return [], [f"roslaunch ended with {launched.returncode}" if ended
                            else f"the probe was not done after {package.start + PROBE:.0f} s"]
            time.sleep(0.5)
    said = looking.stdout.read()
    if looking.returncode or not said:
        return [], [f"the probe failed: see {keep / 'probe'}"]
    answer = json.loads(said)
    return answer["works"], answer["faults"]


def stop(launched: subprocess.Popen) -> None:
    """Stop a launch as with Ctrl-C, and kill remaining processes."""
    for name, patience in ((signal.SIGINT, 30.0), (signal.SIGKILL, 10.0)):
        if launched.poll() is None:
            try:
                os.killpg(launched.pid, name)
                launched.wait(patience)
            except (subprocess.TimeoutExpired, ProcessLookupError):
                continue


def plain_lines(log: Path) -> list[str]:
    return re.sub(r"\x1b\[[0-9;]*m", "", log.read_text(errors="replace")).splitlines()


def warnings_of(lines: Sequence[str]) -> list[str]:
    found = (re.match(r"\[(?:WARN|ERROR|FATAL)\] \[/gazebo\] (.*)", line) for line in lines)
    return [one[1] for one in found if one]


def unnamed(package: Package, lines: Sequence[str]) -> list[str]:
    """Return the parts of `not_served` that the log does not name in exactly one line."""
    found = []
    for part in package.not_served:
        named = [line for line in lines if part in line
                 and re.search(r"WARN|ERROR|FATAL|^\s*(?:ERROR|WARNING)", line)]
        if len(named) != 1:
            found.append(f"'{part}' is named in {len(named)} lines of the log")
    return found


def table(results: Sequence[Result]) -> str:
    """Return the table of docs/porting.md."""
    lines = ["| package | started by | works | faults | unsupported parts, named by the log |",
             "|---|---|---|---|---|"]
    for one in results:
        faults = "; ".join(one.faults) or "-"
        apart = ", ".join(f"`{part}`" for part in one.package.not_served) or "-"
        lines.append(f"| {one.package.name} | `{one.package.launch}` "
                     f"| {'; '.join(one.works) or '-'} | {faults.replace('|', '/')} | {apart} |")
    commits = {repo: commit for one in results
               for repo, commit in one.package.repositories.items()}
    of = ", ".join(f"{repo} {commit[:12]}" for repo, commit in sorted(commits.items()))
    good = sum(not one.faults for one in results)
    summary = f"{good} of {len(results)} packages start, and all their supported parts work."
    return "\n".join([summary, "", *lines, "", f"Sources: {of}."])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0 if each package starts and each supported part of it works."""
    parser = argparse.ArgumentParser(
        prog="tests/peers packages", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="example: mkdir peers; cd peers; sh -c \"$(tests/peers packages --clone)\"; "
               "tests/peers packages peers")
    parser.add_argument("sources", type=Path, nargs="?", help="folder with the checkouts")
    parser.add_argument("--clone", action="store_true", help="print the git commands that fetch "
                        "the repositories into the current folder, and end")
    parser.add_argument("--only", default="", help="packages whose name has this regular "
                        "expression")
    parser.add_argument("--keep", type=Path, help="folder of the logs (a temporary one)")
    parser.add_argument("--write", type=Path, help="put the table into this page")
    parser.add_argument("--rows", type=Path, default=HERE / "packages.yaml",
                        help="table of the packages (%(default)s)")
    asked = parser.parse_args(arguments)
    chosen = [one for one in known_packages(asked.rows) if re.search(asked.only, one.name)]
    if asked.clone:
        print("\n".join(clone_commands(chosen)))
        return 0
    if asked.sources is None or not asked.sources.is_dir():
        parser.error(f"there is no folder {asked.sources}: give one with the checkouts that "
                     "--clone makes")
    keep = (asked.keep or Path(tempfile.mkdtemp(prefix="peers-"))).resolve()
    results = []
    for package in chosen:
        one = run(package, asked.sources.resolve(), keep / package.name)
        results.append(one)
        print(f"{package.name}: {'FAILED' if one.faults else 'works'}", flush=True)
        for sort, items in (("works", one.works), ("WRONG", one.faults), ("warns", one.warnings)):
            for item in items:
                print(f"  {sort} {item}", flush=True)
        if asked.write:
            page.write(asked.write, MARK, table(results))
    print(f"{table(results)}\n\nlogs in {keep}")
    return 1 if any(one.faults for one in results) else 0


if __name__ == "__main__":
    sys.exit(main())
