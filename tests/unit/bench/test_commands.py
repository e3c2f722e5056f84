"""The command line as a whole: one experiment, its name where pip installs it, its examples."""

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from aras_visual_servo_bench import BenchError, Experiment, run, run_study
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.cli.arguments import EXAMPLES, make_parser


@pytest.fixture
def experiment(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("plant: free\nscheme: points\nduration: 6.0\ngain: 2.0\n")
    return path


def test_an_experiments_file_is_run_with_what_the_command_line_changes(experiment, capsys):
    images = []
    for gain in (3.0, 6.0):
        assert main(["run", str(experiment), f"gain={gain}"]) == 0
        told = capsys.readouterr().out
        assert told.startswith("\nmine:\n  Target reached           yes"), told
        assert "Simulation speed" not in told  # it ran in simulated time alone
        images.append(int(told.split("Camera images")[1].split()[0]))
        own = run(Experiment(plant="free", scheme="points", duration=6.0, gain=gain))
        assert images[-1] == len(own.states)
    assert images[0] > 1.2 * images[1]


def test_a_file_may_have_any_name_and_its_report_is_in_out(experiment, tmp_path, monkeypatch):
    """The name looks like an override, and is no UTF-8."""
    path, out = experiment.rename(tmp_path / "bad\udcff<b>$x$=4.yaml"), tmp_path / "out\udcff"

    def output(*words):
        """Return what a command prints to a terminal that takes only valid text."""
        stream = io.TextIOWrapper(io.BytesIO(), "utf-8", errors="strict")
        monkeypatch.setattr(sys, "stdout", stream)
        assert main(list(map(str, words))) == 0
        stream.flush()
        return stream.buffer.getvalue().decode()

    printed = output("analyze", path, "--out", out, "--formats", "")
    assert printed.startswith("\nbad?<b>$x$=4:\n")
    assert f"the page is {tmp_path / 'out?' / 'report.html'}" in printed
    assert json.loads((out / "summary.json").read_text())["name"] == "bad?<b>$x$=4"
    assert "bad?&lt;b&gt;$x$" in (out / "report.html").read_text()
    printed = output("run", path, "duration=0.2", "--out", tmp_path / "run")
    assert printed.startswith("\nbad?<b>$x$=4:\n") and (tmp_path / "run/report.html").exists()
    printed = output("run", "duration=0.2")  # the demo's experiment
    assert "demo:\n  Target reached           NO: " in printed
    assert "\nno report was written; --out DIR writes one: " in printed
    assert "--out" not in output("run", "duration=0.2", "--no-report")


@pytest.mark.parametrize(("words", "told"), [
    (["gian=2.0"], "an experiment has no 'gian': did you mean gain?"),
    (["--out", "o", "--no-report"], "--no-report writes no report: leave out one of them"),
    (["duration=-1"], "duration"),
])  # fmt: skip
def test_what_an_experiment_cannot_be_run_with_is_one_line(experiment, words, told, capsys):
    assert main(["run", str(experiment), *words]) == 1
    said = capsys.readouterr().err
    assert told in said and said.count("\n") == 1 and not Path("o").exists()


def test_pips_program_names_itself(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["/home/me/venv/bin/aras-servo"])
    assert main(["resume", "/nowhere"]) == 1
    assert capsys.readouterr().err.startswith("aras-servo: ")
    options = make_parser().parse_args(["show", "out"])
    with pytest.raises(BenchError, match="give the number of a run: aras-servo show out 0"):
        options.carry_out(options)


COMMANDS = """
import contextlib, io, json, os, shlex, sys
import numba
from aras_visual_servo_base import compile_packages
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.cli.compilation import COMPILED_PACKAGES

# Numba finds all functions in its own cache; of those of one package, no copy is in this one.
os.environ["NUMBA_CACHE_DIR"] = "cache"
for package in COMPILED_PACKAGES[1:]:
    for path in compile_packages.find_sources(package):
        sources = (compile_packages.find_folder(package) / path).parent
        folder = compile_packages.find_cache_folder(sources)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{path.stem}.function.nbi").touch()
found = []
for program, command in json.loads(sys.argv[1]):
    sys.argv = ["/home/me/venv/bin/" + program]
    with contextlib.redirect_stderr(io.StringIO()) as errors, contextlib.suppress(SystemExit):
        main(shlex.split(command))
    found.append(errors.getvalue().splitlines())
print(json.dumps(found))
"""


def test_pips_program_compiles_only_before_it_simulates(tmp_path):
    """In a process without the workspace's packages, which has only their sources."""
    text = "experiment: {plant: free, features: exact, duration: 0.1}\nrepeats: 2\n"
    (tmp_path / "study.yaml").write_text(text)
    run_study(tmp_path / "study.yaml", tmp_path / "done", progress=False)
    simulating = ("run plant=free features=exact duration=0.1", "run study.yaml --dry-run",
                  "run study.yaml --out out --in-process --no-report", "show done 0",
                  "analyze done:0 --out page --formats ''")  # fmt: skip
    others = ("run --help", "table /nowhere", "fly", "run /nowhere.yaml", "run duration=long")
    commands = [*(("aras-servo", one) for one in (*simulating, *others)), ("bench", simulating[0])]
    sources = os.pathsep.join(map(str, Path(__file__).parents[3].glob("src/*/src")))
    made = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)], capture_output=True, text=True,
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": sources},
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    errors = json.loads(made.stdout.splitlines()[-1])
    for command, (first, second, *_) in zip(simulating, errors, strict=False):
        assert first == "compiling before the first simulation, which takes one or two minutes"
        assert second.startswith("compiled in "), (command, second)
    # The set-up has compiled what the workspace's program needs.
    assert "compil" not in str(errors[len(simulating) :])


def test_each_command_is_listed_and_shows_an_example_that_it_understands(capsys):
    made = make_parser()
    with pytest.raises(SystemExit):
        made.parse_args(["--help"])
    # the help of a long name is on the next line
    listed = re.sub(r"\n(    \w+)\n +", r"\n\1 ", capsys.readouterr().out)
    for name, words in EXAMPLES.items():
        (line,) = [one for one in listed.splitlines() if one.startswith(f"    {name} ")]
        assert words.split()[0] == name and len(line.split(None, 1)[1]) > 10
        assert made.parse_args(words.split()).command == name
        with pytest.raises(SystemExit):
            made.parse_args([name, "--help"])
        printed = capsys.readouterr().out
        assert f"example: bench {words}" in printed
        usage, *parts = printed.split("\n\n")
        assert usage.startswith(f"usage: bench {name} [-h] ")
        lines = [line for part in parts for line in part.splitlines() if line.startswith("  ")]
        alone = [line for line, after in zip(lines, [*lines[1:], "  none"], strict=True)
                 if line[2] != " " and "  " not in line.strip() and after[2] != " "]
        assert not alone  # each word is explained
    with pytest.raises(SystemExit):
        made.parse_args([])
    assert "required: COMMAND" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "told"), [
    (["resume", "x", "y"], "argument y"), (["run", "--colour", "a=1"], "--colour"),
    (["protocol", "x", "--out", "o", "a=1"], "unknown argument a=1")])
def test_what_a_command_does_not_know_ends_it_with_2(words, told, capsys):
    with pytest.raises(SystemExit, match="^2$"):
        main(words)
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(("fault", "code"), [(KeyboardInterrupt(), 130), (BrokenPipeError(), 1)])
def test_how_a_command_ends(monkeypatch, fault, code):
    class Ended(io.StringIO):
        def write(self, text):
            raise fault

    err = io.StringIO()
    monkeypatch.setattr(sys, "stdout", Ended())
    monkeypatch.setattr(sys, "stderr", err)
    assert main(["run", "duration=0.1"]) == code
    assert err.closed if code == 1 else err.getvalue() == "bench: interrupted\n"


OWN_FEATURES = """
from aras_visual_servo_controller import Points

class Wrong(Points):
    def measure(self, observation, goal):
        found = super().measure(observation, goal)
        found.L[2, 1] += 0.5
        return found

class Broken(Points):
    def measure(self, observation, goal):
        return 1 / 0
"""


@pytest.mark.parametrize(("words", "code", "said", "told"), [
    (["points"], 0, "points: L is correct (tolerance 0.1 %, 3 poses)", ""),
    (["my_features:Wrong"], 1, "largest error: row 'x1', column vy: L is 0.5, finite diff", ""),
    (["my_features:Wrong", "--tolerance", "0.5"], 0, "Wrong: L is correct (tolerance 50 %", ""),
    (["my_features:Broken"], 1, "", "bench: my_features:Broken raised ZeroDivisionError: div"),
    (["luminance"], 1, "", "bench: luminance needs image: pass as observe"),
    (["points", "--step", "0"], 1, "", "bench: --step is 0, must be above 0"),
])  # fmt: skip
def test_an_interaction_matrix_is_checked(words, code, said, told, tmp_path, monkeypatch, capsys):
    (tmp_path / "my_features.py").write_text(OWN_FEATURES)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_features", raising=False)
    assert main(["check_interaction", *words]) == code
    out, err = capsys.readouterr()
    assert said in out and bool(said) is bool(out)
    assert told in (err.splitlines() or [""])[-1] and bool(told) is bool(err)


def test_what_needs_a_library_that_is_missing_says_so(tmp_path):
    (tmp_path / "a.bag").write_text("")
    cases = {
        "browse x": ("tornado", "tornado.ioloop is not installed: run ./setup.sh; without ROS, p"),
        "table x": ("pyarrow", "without ROS, pip install '.[bench]' in the folder of the sources"),
        "analyze a.bag --out o": ("rosbag", "reading a bag needs ROS's Python p"),
        "convert a.bag": ("mcap", "convert needs the Python packages of ROS and mcap, see ./set")}
    program = (
        "import sys\nfrom aras_visual_servo_bench.cli import main\n"
        f"for words, missing in {[(words, one[0]) for words, one in cases.items()]}:\n"
        "    sys.modules[missing] = None\n    print(main(words.split()))\n"
        "    del sys.modules[missing]\n")
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))})  # fmt: skip
    assert done.stdout.split() == ["1"] * 4, done.stderr
    said = [line for line in done.stderr.splitlines() if line.startswith("bench: ")]
    assert all(told in line for line, (_, told) in zip(said, cases.values(), strict=True)), said
