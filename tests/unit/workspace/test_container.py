"""Container files without building them: stages, entry point, compose file."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[3]
DOCKER = ROOT / "docker"
SUITES = {"bookworm": "12", "trixie": "13"}  # what setup.sh knows, by the names of Debian's images


def instructions() -> list[tuple[str, str]]:
    """The Dockerfile's instructions and their arguments, continued lines made one."""
    text = re.sub(r"^#.*\n", "", (DOCKER / "Dockerfile").read_text(), flags=re.MULTILINE)
    lines = text.replace("\\\n", " ").splitlines()
    words = (line.split(None, 1) for line in lines if line.strip())
    return [(name, " ".join(arguments.split())) for name, arguments in words]


def stages() -> list[list[tuple[str, str]]]:
    """The instructions of each stage, its FROM first."""
    found: list[list[tuple[str, str]]] = []
    for instruction in instructions():
        if instruction[0] == "FROM":
            found.append([])
        if found:
            found[-1].append(instruction)
    return found


def of(stage: list[tuple[str, str]], name: str) -> list[str]:
    return [arguments for kind, arguments in stage if kind == name]


def composed(service: str) -> dict:
    """A service of compose.yaml, what it extends filled in."""
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    own = dict(services[service])
    other = own.pop("extends", None)
    if other is None:
        return own
    base = services[other["service"]]
    lists = {key: base[key] + own[key] for key in base if isinstance(own.get(key), list)
             and key != "command"}  # fmt: skip
    return {**base, **own, **lists}


# --- the image ------------------------------------------------------------------------------------


def test_two_stages_of_the_same_debian_and_only_one_has_compilers():
    prepared, image = stages()
    assert instructions()[0] == ("ARG", "DEBIAN=bookworm")  # before both, so it holds for both
    assert of(prepared, "FROM") == ["debian:${DEBIAN} AS prepared"]
    assert of(image, "FROM") == ["debian:${DEBIAN}"]
    (made,), installed = of(prepared, "RUN"), of(image, "RUN")
    assert "./setup.sh --for demo " in made and "docker/slim" in made
    assert len(installed) == 1 and "$(/tmp/setup.sh --for demo --packages-to-run)" in installed[0]
    assert "--no-install-recommends" in installed[0] and "/var/lib/apt/lists" in installed[0]
    assert of(image, "COPY")[-1] == "--from=prepared /workspace /workspace"


def test_files_that_the_image_is_made_of_exist_and_can_be_started():
    (entry,) = of(stages()[1], "ENTRYPOINT")
    (command,) = of(stages()[1], "CMD")
    for path in [*re.findall(r"[\w./-]+", entry + command), "/workspace/docker/slim"]:
        file = ROOT / path.removeprefix("/workspace/")
        assert os.access(file, os.X_OK), path
    for stage in stages():
        for arguments in of(stage, "COPY"):
            if not arguments.startswith("--from"):
                assert (ROOT / arguments.split()[0]).exists(), arguments


def test_nobody_in_particular_runs_it_and_writes_to_tmp_alone():
    image = stages()[1]
    assert int(of(image, "USER")[0]) > 0
    environment = dict(word.split("=") for line in of(image, "ENV") for word in line.split())
    assert environment.pop("ARAS_PREPARED") == "yes"  # or demo.sh would want to set up
    assert set(environment) >= {"HOME", "ROS_HOME", "MPLCONFIGDIR"}
    assert all(Path(place).parts[:2] == ("/", "tmp") for place in environment.values())
    assert "ARAS_PREPARED" in (ROOT / "demo.sh").read_text()
    # what is made here stays out of the image
    made = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()
            if line.startswith("/") and "*" not in line}  # fmt: skip
    kept_out = set((ROOT / ".dockerignore").read_text().splitlines())
    assert made | {".git", ".venv", "build", "devel", "install", "out"} <= kept_out


def packages(namespace: list[str], system: str, folder: Path, *options: str) -> set[str]:
    """Return the packages that setup.sh requests on a Debian, run in a mount namespace."""
    play = """printf 'ID=debian\\nVERSION_ID="%s"\\n' "$1" | install -m 644 /dev/stdin "$2"
        mount --bind "$2" "$(readlink -f /etc/os-release)"; shift 2; exec "$@"\n"""
    release = folder / "os-release"
    done = subprocess.run(
        [*namespace, "bash", "-ec", play, "-", system, release, ROOT / "setup.sh", *options],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("system", SUITES.values())
def test_nothing_that_only_building_needs_is_asked_for_to_run(namespace, system, tmp_path):
    running = packages(namespace, system, tmp_path, "--for", "demo", "--packages-to-run")
    everything = packages(namespace, system, tmp_path, "--for", "demo", "--packages")
    assert running < everything
    compilers = {"g++", "make", "cmake", "catkin", "python3-venv"}
    assert compilers <= everything - running
    assert ("python3-dev" in everything) == (system == "13")
    assert "python3-dev" not in running
    assert ("ros-environment" in running) == (system == "13")
    assert {"python3-rospy", "rosout", "python3-roslaunch"} <= running


# --- compose --------------------------------------------------------------------------------------


def test_every_service_is_read_only_writes_results_alone_and_is_built_of_either_debian():
    for given in (composed("demo"), composed("desktop")):
        assert given["read_only"] is True and given["tmpfs"] == ["/tmp"] and given["init"] is True
        assert given["user"] == "${ARAS_USER:-1000:1000}"
        assert "../out:/workspace/out" in given["volumes"]
        assert "network_mode" not in given and "ports" not in given  # nothing listens outside
        assert given["image"] == "aras-visual-servo"
    build = given["build"]
    context = (DOCKER / build["context"]).resolve()
    assert context == ROOT and context / build["dockerfile"] == DOCKER / "Dockerfile"
    default = re.fullmatch(r"\$\{DEBIAN:-(\w+)\}", build["args"]["DEBIAN"])[1]
    assert ("ARG", f"DEBIAN={default}") in instructions() and default in SUITES
    known = re.findall(r'^ +"debian (\d+)"\)', (ROOT / "setup.sh").read_text(), re.MULTILINE)
    assert known == list(SUITES.values())


# --- its entry point ------------------------------------------------------------------------------


Start = Callable[..., subprocess.CompletedProcess]


@pytest.fixture
def start(tmp_path: Path) -> Start:
    """Factory: the entry point of a workspace, started with a command; what it does is returned."""
    workspace = tmp_path / "workspace"
    for folder in ("docker", "devel", ".venv/bin", "loops/a/__pycache__"):
        (workspace / folder).mkdir(parents=True)
    shutil.copy(DOCKER / "entrypoint.sh", workspace / "docker")
    (workspace / "devel" / "setup.bash").write_text("export SOURCED=${UNSET_HERE}yes\n")
    (workspace / "loops" / "a" / "__pycache__" / "x.nbi").write_text("compiled")
    (tmp_path / "tmp").mkdir()

    def run(*command: str, **environment: str) -> subprocess.CompletedProcess:
        given = {"PATH": os.environ["PATH"], "TMPDIR": str(tmp_path / "tmp"), **environment}
        entry = workspace / "docker" / "entrypoint.sh"
        return subprocess.run([entry, *command], env=given, capture_output=True, text=True,
                              cwd=tmp_path, timeout=20)  # fmt: skip

    return run


def test_the_command_runs_in_the_workspace_s_environment(start, tmp_path):
    """In the entry point's place, or Ctrl-C and the container's end would reach a shell that waits.
    """
    tells = 'echo "$SOURCED|$PATH|$NUMBA_CACHE_DIR|$1|$PPID"; exit 7'
    done = start("bash", "-c", tells, "-", "two words")
    sourced, path, loops, word, parent = done.stdout.strip().split("|")
    assert (done.returncode, done.stderr, sourced, word) == (7, "", "yes", "two words")
    assert path.split(":")[0] == str(tmp_path / "workspace/.venv/bin")
    assert parent == str(os.getpid())
    assert loops == str(tmp_path / "tmp" / f"loops-{os.getuid()}")
    assert Path(loops, "a/__pycache__/x.nbi").read_text() == "compiled"
    assert os.listdir(tmp_path / "tmp") == [Path(loops).name]  # and nothing half made beside it
    # what this start has compiled is there for the next one, and a named place is left alone
    (Path(loops) / "own").touch()
    shutil.rmtree(Path(loops) / "a")
    assert start("bash", "-c", "ls $NUMBA_CACHE_DIR").stdout == "own\n"
    shutil.rmtree(loops)
    done = start("printenv", "NUMBA_CACHE_DIR", NUMBA_CACHE_DIR="/elsewhere")
    assert done.stdout == "/elsewhere\n" and not os.listdir(tmp_path / "tmp")


@pytest.mark.parametrize("begins", ["mkdir -p $last/a; ", ""], ids=["cut short", "at once"])
def test_loops_that_find_no_room_are_told_and_never_taken_for_whole(start, tmp_path, begins):
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "cp").write_text(f"#!/bin/bash\nlast=${{@: -1}}; {begins}echo full >&2; exit 1\n")
    (tools / "cp").chmod(0o755)
    done = start("true", PATH=f"{tools}:{os.environ['PATH']}")
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "cannot write the compiled loops to" in done.stderr and "--tmpfs /tmp" in done.stderr
    assert not os.listdir(tmp_path / "tmp")
    assert start("true").returncode == 0
    done = start("true", TMPDIR=str(tmp_path / "none"))
    assert done.returncode == 1 and "--tmpfs /tmp" in done.stderr
