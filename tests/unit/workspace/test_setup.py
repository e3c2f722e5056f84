"""Messages of setup on unsuitable machines: one line states the remedy.

Each machine is this one seen from a namespace of its own, where some files are others. Nothing is
installed: what would do so is among those files.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
DEBIAN = 'ID=debian\nVERSION_ID="12"\n'
PYTHON = "#!/bin/sh\necho 3.11\n"
NOTHING_INSTALLED = "#!/bin/sh\nexit 1\n"
ROOM = "#!/bin/sh\necho Avail; echo 100000\n"
# Where root runs the tests, it gives up being root by hand.
READ_ALL = "+dac_override"  # pytest's folders are their owner's alone
AS_USER = f"setpriv --reuid=1000 --clear-groups --inh-caps={READ_ALL} --ambient-caps={READ_ALL}"


@pytest.fixture
def machine(namespace: list[str], tmp_path: Path):
    """Factory: what ./setup.sh prints and its status, in a folder, where files are others."""

    def run(
        files: dict[str, str] | None = None,
        folder: str = "workspace",
        before: str = "",
        root: bool = True,
        **environment: str,
    ) -> tuple[int, str]:
        workspace = tmp_path / folder
        if not workspace.exists():
            workspace.mkdir(parents=True)
            shutil.copy(ROOT / "setup.sh", workspace)
            shutil.copytree(ROOT / "requirements", workspace / "requirements")
            (workspace / "src").mkdir()
        printed = tmp_path / "printed"
        printed.unlink(missing_ok=True)
        words = {"WORKSPACE": f"'{workspace}'", "PRINTED": f"'{printed}'"}
        for word, path in words.items():
            before = before.replace(word, path)
        commands = [before]
        given = {"/etc/os-release": DEBIAN, "/usr/bin/python3": PYTHON,
                 "/usr/bin/dpkg-query": NOTHING_INSTALLED, **(files or {})}  # fmt: skip
        for number, (place, text) in enumerate(given.items()):
            stand_in = tmp_path / str(number)
            stand_in.write_text(text)
            stand_in.chmod(0o755)
            commands.append(f"mount --bind '{stand_in}' $(readlink -f {place})")
        commands.append(f"cd '{workspace}' && exec {'' if root else AS_USER} ./setup.sh")
        done = subprocess.run(
            [*namespace, "bash", "-ec", "\n".join(commands)],
            env={"PATH": os.environ["PATH"], "HOME": str(tmp_path), **environment},
            stdin=subprocess.DEVNULL, stdout=printed.open("a"), stderr=subprocess.STDOUT,
            timeout=300,
        )  # fmt: skip
        return done.returncode, printed.read_text()

    return run


UBUNTU = {"/etc/os-release": 'ID=ubuntu\nVERSION_ID="24.04"\n'}


def disk(room: str, apt: str = "") -> dict[str, str]:
    """Files of a machine whose disk has this room, MB, in words of a shell."""
    return {"/usr/bin/df": f"#!/bin/sh\necho Avail; echo {room}\n",
            "/usr/bin/apt-get": f"#!/bin/sh\n{apt}\n"}  # fmt: skip


@pytest.mark.parametrize(("given", "told"), [
    ({"files": UBUNTU}, "'ubuntu 24.04'. Ubuntu does not"),
    ({"files": {"/etc/os-release": 'ID=debian\nVERSION_ID="11"\n'}}, "Use Debian 12 or 13"),
    ({"files": {"/etc/os-release": "ID=arch\n"}}, "or the container in docker/"),
    ({"files": {"/usr/bin/uname": "#!/bin/sh\necho aarch64\n"}}, "Use an x86_64 machine"),
    ({"files": {"/usr/bin/python3": "#!/bin/sh\necho 3.12\n"}},
     "ln -sf python3.11 /usr/bin/python3"),
    ({"files": UBUNTU, "CONDA_PREFIX": "/opt/conda"}, "A conda shell is active; RoboStack"),
    ({"folder": "my work"}, "Move the workspace ... without spaces"),
    ({"folder": "a:b"}, "Move the workspace ... do not support"),
    ({"folder": "x" * 120 + "/" + "y" * 120}, "Move the workspace ... at most 200 letters"),
    ({"root": False},
     "As root, run:  apt-get update && apt-get install --no-install-recommends catkin"),
    ({"files": disk("700")}, "needs about 2000 MB below /usr, where 700 MB are left"),
    ({"files": disk("9000"), "before": "mount --bind WORKSPACE WORKSPACE && "
      "mount -o remount,ro,bind WORKSPACE"}, "cannot write to ... read-only"),
])  # fmt: skip
def test_a_machine_that_cannot_do_is_told_before_anything_begins(machine, given, told, tmp_path):
    status, text = machine(**given)
    assert status == 1 and all(part in text for part in told.split(" ... ")), text
    assert not (tmp_path / "workspace" / "build").exists()
    if "CONDA_PREFIX" in given:
        assert text.count("docs/installing.md, 'Other systems'") == 2  # of Ubuntu, of conda
        assert "## Other systems\n" in (ROOT / "docs" / "installing.md").read_text()


def test_a_disk_that_is_full_when_a_step_fails_is_named(machine):
    room = "$([ -e $HOME/full ] && echo 3 || echo 9000)"
    status, text = machine(disk(room, "touch $HOME/full\nexit 1"))
    assert status == 1 and "the disk of" in text and "is full" in text


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone can become another user")
def test_an_environment_that_is_a_link_is_left_alone(machine, tmp_path):
    theirs = tmp_path / "another"
    theirs.mkdir()
    (theirs / "kept").touch()
    status, text = machine(before=f"ln -s '{theirs}' WORKSPACE/.venv")
    assert status == 1 and ".venv is a link" in text and "rm .venv" in text
    assert [p.name for p in theirs.iterdir()] == ["kept"]


NO_NETWORK = "there seems to be no network"


@pytest.mark.parametrize(("apt", "told", "left_out"), [
    ("[ $3 = update ] || { echo \"E: Temporary failure resolving 'deb.debian.org'\"; exit 100; }",
     NO_NETWORK, "E: "),
    ("[ $3 = update ] || { echo 'E: Unable to locate package catkin'; exit 100; }", NO_NETWORK,
     "E: "),
    ("echo 'OSError: [Errno 28] No space left on device'; exit 1",
     "a disk was full: free some space", "Errno"),
    ("seq 90; echo 'E: dpkg is in a bad mood'; exit 100", "E: dpkg is in a bad mood", "\n70\n"),
])  # fmt: skip
def test_a_step_that_fails_says_why(machine, apt, told, left_out):
    """Where the reason is known, the log's end would only hide it."""
    status, text = machine({"/usr/bin/apt-get": f"#!/bin/sh\n{apt}\n", "/usr/bin/df": ROOM})
    assert status == 1 and told in text and left_out not in text
    if told == NO_NETWORK:
        assert "fix the cause and start setup.sh again" in text
        assert "apt-get update ... done" in text


def test_an_installation_that_was_cut_short_is_ended_first(machine, tmp_path):
    files = {
        "/usr/bin/apt-get": "#!/bin/sh\nexit 100\n",
        "/usr/bin/df": ROOM,
        "/usr/bin/dpkg": f"#!/bin/sh\necho $1 >>'{tmp_path}/asked'\n",
    }
    machine(files)
    assert (tmp_path / "asked").read_text() == "--audit\n"
    # what is half installed is what dpkg tells of
    files["/usr/bin/dpkg"] = f"#!/bin/sh\necho $1 | tee -a '{tmp_path}/asked'\n"
    text = machine(files)[1]
    assert "dpkg --configure -a (an earlier installation was interrupted) ... done" in text
    assert (tmp_path / "asked").read_text() == "--audit\n--audit\n--configure\n"


def test_a_second_set_up_waits_for_the_first_and_says_so(machine):
    # the first one has the lock before the second begins, and until that has said that it waits
    hold = """exec 7<WORKSPACE/setup.sh; flock 7
        (for turn in {1..600}; do ! grep -q Another PRINTED || break; sleep 0.1; done
        echo ended >>PRINTED) & exec 7<&-"""
    status, text = machine({"/usr/bin/apt-get": "#!/bin/sh\nexit 1\n"}, before=hold)
    told, _, after = text.partition("Another set-up of this workspace is running; waiting")
    assert told == "" and after.index("ended") < after.index("Installing Debian packages")


# Set-up's own steps on a machine that has all Debian packages, played: an interpreter that makes
# itself the virtual environment's, and tells what it is asked for.
PLAYED = r"""#!/bin/bash
case "$*" in
  *version_info*) echo 3.11 ;;
  -V) echo Python 3.11.2 ;;
  *"-m venv"*) mkdir -p .venv/bin .venv/lib; cp "$0" .venv/bin/python
    [[ $* == *--system-site-packages* ]] && open=true || open=false
    echo "include-system-site-packages = $open" >.venv/pyvenv.cfg ;;
  *) echo "$@" >>asked ;;
esac
"""
ALL_INSTALLED = '#!/bin/bash\nprintf "installed %s\\n" "${@:3}"\n'


def played(tmp_path: Path, loops: str = "", build: str = "", pip: str = "") -> dict[str, str]:
    """Files of such a machine; commands of its compiling, its catkin_make and its pip."""
    package = tmp_path / "workspace" / "src" / "ours" / "src" / "ours"
    if not package.exists():
        shutil.copytree(ROOT / "requirements", tmp_path / "workspace" / "requirements")
        shutil.copy(ROOT / "setup.sh", tmp_path / "workspace")
        package.mkdir(parents=True)
        (package / "loops.py").write_text("from .compiled import jit\n")
    compiles = f"  *compile_packages*) {{ {loops or 'true'}; }} && echo loops >>asked ;;\n"
    compiles += f"  *-m\\ pip*) {{ {pip or 'true'}; }} && echo $* >>asked ;;\n"
    builds = f"mkdir -p devel; {{ {build or 'true'}; }} && echo build >>asked\n"
    return {
        "/usr/bin/python3": PLAYED.replace("  *)", f"{compiles}  *)"),
        "/usr/bin/dpkg-query": ALL_INSTALLED, "/usr/bin/df": ROOM,
        "/usr/bin/catkin_make": f"#!/bin/bash\n{builds}",
    }  # fmt: skip


def meets(own: str, other: str) -> str:
    """A command that ends well where the other one runs at the same time."""
    return (f"touch {own}; for t in {{1..200}}; do [[ ! -e {other} ]] || break; sleep 0.1; done; "
            f"[[ -e {other} ]]")  # fmt: skip


def test_workspace_and_loops_are_made_side_by_side_and_only_once(machine, tmp_path):
    """pip sees Debian's packages only after it has done: they may be half installed, and where a
    version fits pip would do without its own."""
    files = played(tmp_path, loops=meets("one", "two"), build=meets("two", "one"),
                   pip="cat .venv/pyvenv.cfg >seen")  # fmt: skip
    status, text = machine(files)
    assert status == 0, text
    assert "Building the workspace, compiling loops ... done" in text
    workspace = tmp_path / "workspace"
    asked = (workspace / "asked").read_text().splitlines()
    assert asked.count("loops") == asked.count("build") == 1
    assert sum("pip" in line and "--no-compile" in line for line in asked) == 1
    assert sum("compileall" in line for line in asked) == 1
    assert (workspace / "seen").read_text() == "include-system-site-packages = false\n"
    made = (workspace / ".venv" / "pyvenv.cfg").read_text()
    assert made == "include-system-site-packages = true\n"
    assert machine(files) == (0, "")
    assert (workspace / "asked").read_text().splitlines() == asked


def test_the_workspace_is_built_while_pip_works_with_debian_s_packages_in_sight(machine, tmp_path):
    """By the new environment's interpreter, even where an earlier set-up was stopped in its pip."""
    build = f"cat .venv/made >>seen; printenv PYTHONPATH >>seen; {meets('two', 'one')}"
    files = played(tmp_path, pip=meets("one", "two"), build=build)
    made = "mkdir -p .venv/bin .venv/lib; "
    files["/usr/bin/python3"] = files["/usr/bin/python3"].replace(
        made, f"sleep 0.5; rm -rf .venv; {made} echo anew >.venv/made; "
    )
    stale = tmp_path / "workspace" / ".venv"
    stale.mkdir()
    (stale / "setup.stamp").write_text("another bench\n")
    (stale / "made").write_text("before\n")
    status, text = machine(files)
    assert status == 0, text
    workspace = tmp_path / "workspace"
    assert (workspace / "seen").read_text() == "anew\n/usr/lib/python3/dist-packages\n"
    lines = [line.partition(" ...")[0] for line in text.splitlines()]
    assert lines[-2].startswith("Making the virtual environment")
    assert lines[-1] == "Building the workspace, compiling loops"


# What dpkg knows of a machine where Debian's packages are installed but for a few.
LACKING = """#!/bin/bash
for name in "${@:3}"; do
  case $name in python3-venv|rviz|rosbash) ;; *) echo "installed $name" ;; esac
done
"""


def test_what_pip_was_stopped_in_goes_on_in_the_same_environment(machine, tmp_path):
    files = played(tmp_path, pip="[[ -e corrected ]] || { echo 'no such wheel'; false; }")
    status, text = machine(files)
    assert status == 1 and "no such wheel" in text
    assert "this step failed: Making the virtual environment .venv" in text
    kept = tmp_path / "workspace" / ".venv" / "kept"
    kept.touch()
    (tmp_path / "workspace" / "corrected").touch()
    status, text = machine(files)
    assert status == 0 and text.startswith("Installing the Python packages for bench")
    assert kept.exists() and "= true" in (kept.parent / "pyvenv.cfg").read_text()


TRIXIE = {"/etc/os-release": 'ID=debian\nVERSION_ID="13"\n',
          "/usr/bin/g++": '#!/bin/sh\necho "$@" >>compiled\n'}  # fmt: skip


def on_trixie(files: dict[str, str]) -> dict[str, str]:
    python = files["/usr/bin/python3"].replace(
        "echo 3.11 ;;", "[[ $* == *cp* ]] && echo cp313 || echo 3.13 ;;"
    )
    return {**files, **TRIXIE, "/usr/bin/python3": python}


def test_pybullet_is_built_where_it_has_no_wheel_its_physics_optimised_and_once(machine, tmp_path):
    """Its sources as its own set-up hands them to the compiler, and what becomes of the options."""
    wheel = """if [[ $* == *" wheel "* ]]; then
  [[ -e building ]] || exit 1
  for source in src/physics.cpp examples/src/window.cpp; do "$CXX" $CXXFLAGS -c $source -fPIC; done
  [[ $CFLAGS == *-g0* && $CXXFLAGS == *-g0* ]] && touch "${@: -2:1}/pybullet-3.2.7-cp313.whl"
elif [[ $* == *building.txt ]]; then touch building; fi"""
    files = on_trixie(played(tmp_path, pip=wheel))
    status, text = machine(files)
    assert status == 0 and "building PyBullet for this Python" in text
    workspace = tmp_path / "workspace"
    compiled = (workspace / "compiled").read_text().splitlines()
    levels = [[word for word in line.split() if word.startswith("-O")][-1] for line in compiled]
    assert levels == ["-O2", "-O1"]  # of several the last one counts
    shutil.rmtree(workspace / ".venv")
    status, text = machine(files)
    assert status == 0 and (workspace / "compiled").read_text().splitlines() == compiled


def test_where_debian_s_packages_fail_pip_ends_too(machine, tmp_path):
    pip = """[[ -e corrected ]] || {
  trap 'sleep 0.5; exit 1' TERM  # it puts away what it has begun
  sleep 60 & wait; touch late; }"""
    files = played(tmp_path, pip=pip)
    files["/usr/bin/dpkg-query"] = LACKING
    files["/usr/bin/apt-get"] = '#!/bin/bash\ncase "$*" in *rviz*) exit 100 ;; esac\n'
    status, text = machine(files)
    assert status == 1 and "this step failed:   apt-get install (this may take" in text
    (tmp_path / "workspace" / "corrected").touch()
    files["/usr/bin/apt-get"] = "#!/bin/sh\n"
    status, text = machine(files)  # it would wait for what the first one left
    assert status == 0 and "Another set-up" not in text
    assert not (tmp_path / "workspace" / "late").exists()


def test_of_two_steps_side_by_side_the_one_that_failed_is_shown_and_made_again(machine, tmp_path):
    broken = played(tmp_path, build="seq 50; echo 'a header is missing'; false")
    status, text = machine(broken)
    assert status == 1 and "this step failed: Building the workspace, compiling loops" in text
    assert text.index("a header is missing") < text.index("this step failed")
    status, text = machine(played(tmp_path))
    assert status == 0 and "Building the workspace ... done" in text and "loops" not in text


INTERRUPTS = "kill -INT $(cat setup.pid)"
# Before each command of a script: an interrupt, where a step is at work and has not been noted yet.
NOT_NOTED = f"""set -T
trap '[[ $BASH_COMMAND != "background["*"]="* ]] || {{
  until [[ -e at_work ]]; do sleep 0.1; done; {INTERRUPTS}; }}' DEBUG"""
LATE = "sleep 60; touch late"


@pytest.mark.parametrize(
    ("steps", "script"),
    [
        ({"build": f"{INTERRUPTS}; {LATE}"}, ""),
        # a command that Bash has only just begun does so at times
        ({"build": f"trap '' TERM; {INTERRUPTS}; sleep 0.5; trap - TERM; {LATE}"}, ""),
        ({"pip": f"touch at_work; {LATE}"}, NOT_NOTED),
    ],
    ids=["in a step", "a step that lost the first signal", "a step that is not noted yet"],
)
def test_an_interrupted_set_up_takes_its_steps_with_it(machine, tmp_path, steps, script):
    files = played(tmp_path, **steps)
    (tmp_path / "first").write_text(script)
    before = f"echo $$ >'{tmp_path}/workspace/setup.pid'"
    status, text = machine(files, before=before, BASH_ENV=str(tmp_path / "first"))
    assert status == 130 and "loops ... done" not in text
    shutil.rmtree(tmp_path / "workspace" / ".venv")  # its pip is that of these steps
    status, text = machine(played(tmp_path))  # it would wait for what the first one left
    assert status == 0 and "Another set-up" not in text
    assert not (tmp_path / "workspace" / "late").exists()


# What a conda, a pyenv, another ROS workspace and one's own settings of pip leave in a shell.
FOREIGN = {
    "CONDA_PREFIX": "/opt/conda", "PYENV_ROOT": "/opt/pyenv", "PYENV_VERSION": "3.9.1",
    "VIRTUAL_ENV": "/home/me/venv", "PYTHONPATH": "/opt/ros/lib", "PYTHONHOME": "/opt/conda",
    "CMAKE_PREFIX_PATH": "/opt/conda:/opt/ros", "ROS_PACKAGE_PATH": "/opt/ros/share",
    "ROS_ROOT": "/opt/ros", "ROS_ETC_DIR": "/opt/ros/etc",
    "CC": "/opt/conda/bin/gcc", "CXX": "/opt/conda/bin/g++", "CFLAGS": "-I/opt/conda/include",
    "CXXFLAGS": "-I/opt/conda/include", "LDFLAGS": "-L/opt/conda/lib",
    "PIP_USER": "1", "PIP_TARGET": "/home/me/lib", "PIP_PREFIX": "/home/me",
    "PIP_REQUIRE_VIRTUALENV": "1",
}  # fmt: skip
HARMLESS = {"CONDA_PREFIX", "PYENV_ROOT", "PYENV_VERSION"}  # nobody reads them without their tools


def test_nothing_of_a_conda_pyenv_or_ros_shell_reaches_the_steps(machine, tmp_path):
    tools = tmp_path / "conda" / "bin"
    tools.mkdir(parents=True)
    for name in ("python", "python3", "pip", "cmake", "make", "gcc", "g++", "catkin_make", "df",
                 "find", "flock", "sha256sum", "dpkg-query", "apt-get", "env"):  # fmt: skip
        (tools / name).write_text("#!/bin/bash\necho $0 >>$HOME/used\nexit 77\n")
        (tools / name).chmod(0o755)
    files = played(tmp_path, loops="env >>$HOME/seen", build="env >>$HOME/seen")
    tells = files["/usr/bin/python3"].replace("*) echo", "*) env >>$HOME/seen; echo")
    files["/usr/bin/python3"] = tells
    foreign = " ".join(f"{name}={value}" for name, value in FOREIGN.items())
    shell = f"export PATH={tools}:$PATH {foreign}"
    status, text = machine(files, before=shell)
    assert status == 0, text
    assert not (tmp_path / "used").exists()
    seen = (tmp_path / "seen").read_text().splitlines()
    assert {line for line in seen if line.startswith("PIP_USER=")} == {"PIP_USER=0"}
    paths = [line for line in seen if line.startswith(("PATH=", "PYTHONPATH="))]  # own libraries
    assert paths and not [line for line in paths if "/opt" in line or str(tools) in line]
    names = {line.partition("=")[0] for line in seen}
    assert not names & (set(FOREIGN) - HARMLESS - {"PIP_USER", "PYTHONPATH"})
