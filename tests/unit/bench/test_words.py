"""Command line: every option reaches the function that uses it."""

import sys
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
import yaml

import aras_visual_servo_bench.ros
from aras_visual_servo_bench import load_run
from aras_visual_servo_bench.cli import (
    analyze,
    browse,
    dataset,
    main,
    protocol,
    results,
    run,
    show_tune,
)
from aras_visual_servo_bench.errors import BenchError, StudyError
from aras_visual_servo_bench.metrics import summary
from aras_visual_servo_bench.plots import study_figures
from aras_visual_servo_bench.studies import replay, tuner
from aras_visual_servo_bench.studies import study_folder as folders
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.web.report import video
from aras_visual_servo_bench.web.report import write as reports

STUDY = """experiment: {plant: free, features: images}
repeats: 4
seed: 10
vary: {gain: [1.0, 2.0], delay: [0.0, 0.1]}
cases:
  scheme: [{name: a, set: {scheme: points}}, {name: b, set: {scheme: luminance}}]
  start: [{name: near, set: {lag: 0.1}}, {name: far, set: {lag: 0.2}}]
"""


@pytest.fixture
def asked(monkeypatch):
    """List of calls with their arguments; `stub` replaces a function by a recording one."""
    found = []

    def stub(place, name, answer=None):
        def called(*given, **more):
            found.append((name, *given, *more.values()))
            return answer(*given) if callable(answer) else answer

        monkeypatch.setattr(place, name, called)

    stub.found = found
    for place in (results, protocol):
        monkeypatch.setattr(place.Results, "read", lambda folder: f"<{folder}>")
    return stub


def test_a_table_is_of_the_rows_and_columns_that_were_asked_for(asked, tmp_path, capsys):
    asked(results.tables, "make_table", "rows")
    asked(results.tables, "format_table", "a b\n")
    words = ["table", "x", "y", "--by", "p, q,", "--metrics", "m"]
    assert main([*words, "--format", "tex"]) == 0
    assert asked.found == [("make_table", ["<x>", "<y>"], ["p", "q"], ["m"]),
                           ("format_table", "rows", "tex")]
    assert capsys.readouterr().out == "a b\n"
    assert main([*words, "--out", str(tmp_path / "t.md")]) == 0
    assert asked.found[-1] == ("format_table", "rows", "md") and not capsys.readouterr().out
    assert (tmp_path / "t.md").read_text() == "a b\n"
    assert main([*words, "--out", str(tmp_path)]) == 1
    assert main([*words, "--format", "pdf"]) == 1 and "pdf" in capsys.readouterr().err


def test_plots_are_put_where_they_are_wanted(asked, tmp_path, capsys):
    asked(study_figures, "write_figures", ["one.png", "two.svg"])
    assert main(["plot", "x", "y", "--metrics", "m,n"]) == 0
    assert capsys.readouterr().out == "one.png\ntwo.svg\n"
    assert main(["plot", "x", "--format", "svg, pdf", "--out", "there"]) == 0
    assert main(["plot", "x", "--paper"]) == 0
    capsys.readouterr()
    assert [[str(one) if not isinstance(one, list) else list(map(str, one)) for one in call]
            for call in asked.found] == [
        ["write_figures", ["<x>", "<y>"], "x/plots", ["png"], ["m", "n"], ["x", "y"],
         "False"],
        ["write_figures", ["<x>"], "there", ["svg", "pdf"], [], ["x"], "False"],
        ["write_figures", ["<x>"], "x/plots", ["pdf"], [], ["x"], "True"]]


def test_differences_are_of_the_first_folder_and_the_second(asked, capsys):
    asked(results.compare, "find_differences", "found")
    asked(results.compare, "describe_differences", "so and so")
    asked(results.captions, "describe_repeats", [])
    assert main(["diff", "x", "y", "--by", "p", "--metrics", "m,n"]) == 0
    assert main(["diff", "x", "y", "--all"]) == 0
    assert asked.found == [
        ("find_differences", "<x>", "<y>", ["p"], ["m", "n"], ""),
        ("describe_differences", "found", False), ("describe_repeats", ["<x>", "<y>"]),
        ("find_differences", "<x>", "<y>", [], [], ""),
        ("describe_differences", "found", True), ("describe_repeats", ["<x>", "<y>"]),
    ]
    assert capsys.readouterr().out == 2 * "so and so\n"


@pytest.fixture
def study(tmp_path, asked, monkeypatch):
    """A study's file; studies are made, and not carried out."""
    path = tmp_path / "mine.yaml"
    path.write_text(STUDY)
    for place in (protocol, dataset):
        monkeypatch.setattr(place.StudyFolder, "create", lambda *given: given)
    asked(run, "carry_out", 7)
    return path


def test_a_protocol_is_carried_out_in_part(asked, study, tmp_path, capsys, monkeypatch):
    written = []
    monkeypatch.setattr(protocol.Results, "read", lambda folder: SimpleNamespace(
        write_csv=lambda path: written.append((folder, path)) or 12))
    out = tmp_path / "out"
    words = ["protocol", str(study), "--out", str(out), "--seeds", "2", "--first", "5", "--mix",
             "--case", "b", "--start", "far", "--start", "near", "--workers", "3"]
    assert main(words) == 7
    ((_, (folder, made, text), options),) = asked.found
    assert (folder, written) == (out, [(out, out / "table.csv")])
    assert capsys.readouterr().out == f"wrote {out / 'table.csv'}: 12 runs\n"
    whole = Study.from_mapping(yaml.safe_load(STUDY))
    assert (made.repeats, made.seed, made.vary) == (2, 5, whole.vary)
    assert [case.name for case in made.case_axes["scheme"]] == ["b"]
    assert [case.name for case in made.case_axes["start"]] == ["near", "far"]
    assert made.cases["scheme"][0]["set"] == {"scheme": "luminance"}
    assert Study.from_mapping(yaml.safe_load(text)).digest == made.digest
    assert (options.mix, options.workers, options.fail_fast, options.no_report) == (
        True, 3, False, True)
    asked.found.clear()
    assert main(words[:4]) == 7
    (_, (_, made, _), options) = asked.found[0]
    assert made.digest == whole.digest and not options.mix and options.workers == 0
    assert main([*words[:4], "--condition", "rain"]) == 1
    assert "condition 'rain'" in capsys.readouterr().err


def test_a_data_set_is_of_all_images_or_of_views_with_depth_or_without(asked, study, tmp_path,
                                                                        capsys):
    asked(dataset.images, "check_room", "takes 3 MB")
    asked(dataset, "count_stored_runs", 2)
    out = tmp_path / "out"
    words = ["dataset", str(study), "repeats=3", "--out", str(out)]
    for more, pictures, depth in (([], "all", False), (["--views"], "first", False),
                                  (["--depth"], "all", True)):
        asked.found.clear()
        assert main([*words, *more, "--in-process"]) == 7
        kept, room, (_, (folder, made, text), options) = asked.found
        assert kept == ("count_stored_runs", out) and room == ("check_room", made, out, 2)
        assert folder == out and (made.pictures, made.depth, made.repeats) == (pictures, depth, 3)
        assert Study.from_mapping(yaml.safe_load(text)).digest == made.digest
        assert options.in_process and options.no_report and not options.mix | options.fail_fast
        assert capsys.readouterr().out == "takes 3 MB\n"


def test_a_run_is_shown_again_with_what_has_changed(asked, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(show_tune.StudyFolder, "open", lambda path: f"<{path.name}>")
    asked(replay, "replay", ("run", {"decay": (1, 2)}))
    asked(video, "write_with_video", ["a.html", "b.mp4"])
    assert main(["show", str(tmp_path / "s"), "12"]) == 0
    assert main(["show", str(tmp_path / "s"), "3", "--out", "there"]) == 0
    assert [tuple(map(str, call)) for call in asked.found] == [
        ("replay", "<s>", "12"), ("write_with_video", "run", str(tmp_path / "s" / "show-12")),
        ("replay", "<s>", "3"), ("write_with_video", "run", "there")]
    assert capsys.readouterr().out == 2 * (
        "a.html\nb.mp4\ndiffers from the recorded run: decay was 1, is 2\n")

    def fail(*_):
        raise StudyError("run 3 failed") from ZeroDivisionError("by nothing")

    monkeypatch.setattr(replay, "replay", fail)
    out = tmp_path / "deep" / "er"
    assert main(["show", str(tmp_path / "s"), "3", "--out", str(out)]) == 1
    told = capsys.readouterr().err
    assert told.endswith(f": run 3 failed; traceback: {out / 'traceback.txt'}\n")
    assert "ZeroDivisionError: by nothing" in (out / "traceback.txt").read_text()


def test_settings_are_searched_for_as_the_words_say(asked, study, tmp_path, capsys, monkeypatch):
    made, best = [], SimpleNamespace(values=(1.5, 0.25), cost=-0.123456, success=0.75,
                                     excursion=0.456, violation=0.0)

    class Tuner:
        candidates = range(9)

        def __init__(self, *given):
            made.append(given)

        def search(self, evaluations):
            made.append(evaluations)
            return best

        def write(self):
            return "tuned.yaml"

    class Pool:
        def __enter__(self):
            return "workers"

        def __exit__(self, *_):
            made.append("closed")

    monkeypatch.setattr(tuner, "Tuner", Tuner)
    monkeypatch.setattr(run, "make_pool", lambda options: Pool())
    words = ["tune", str(study), "repeats=2", "--over", "gain=0.5:4", "--over", "lag=0:1",
             "--out", str(tmp_path / "o")]
    assert main([*words, "--metric", "decay_rate", "--evaluations", "5", "--success", "0.5"]) == 0
    (sought, ranges, metric, out, _, part), count, closed = made
    assert [(r.key, r.low, r.high) for r in ranges] == [("gain", 0.5, 4.0), ("lag", 0.0, 1.0)]
    assert sought.repeats == 2 and list(sought.vary) == ["delay"]
    assert (metric, out, part, count, closed) == ("decay_rate", tmp_path / "o", 0.5, 5, "closed")
    assert capsys.readouterr().out == (
        "gain=1.5, lag=0.25: decay_rate 0.1235, success 75%, image excursion 0.46; best of 9 "
        "candidates (tuned.yaml)\n")
    best.violation = 0.1
    made.clear()
    assert main(words) == 1
    assert "no candidate keeps the target in the image" in capsys.readouterr().err
    assert made[0][2] == "settled" and made[0][5] == 1.0 and made[1] == 48


def test_runs_that_are_analyzed_have_the_names_that_they_are_given(asked, tmp_path, capsys,
                                                                    monkeypatch):
    shown = []
    monkeypatch.setattr(analyze, "ProgressBar", lambda _stream: SimpleNamespace(
        show=lambda part, what: shown.append((part, what)), close=lambda: shown.append("closed")))

    def read(given, progress):
        progress(0.5)
        return SimpleNamespace(name=f"of {given}")

    monkeypatch.setattr(analyze, "load_run", read)
    asked(analyze, "write_reports")
    words = ["analyze", "a", "b", "--out", str(tmp_path)]
    assert main([*words, "--names", "one, two", "--formats", "svg,png", "--paper"]) == 0
    assert main([*words, "--names", "one,one"]) == 0
    assert main(words) == 0
    assert [([run.name for run in runs], *more) for _, runs, *more in asked.found] == [
        (["one", "two"], tmp_path, ["svg", "png"], True),
        (["one (1)", "one (2)"], tmp_path, ["png", "svg", "pdf"], False),
        (["of a", "of b"], tmp_path, ["png", "svg", "pdf"], False)]
    assert shown[:3] == [(0.125, "reading a"), (0.375, "reading b"), "closed"]
    for more, told in ((["--names", "one"], "1 names for 2 runs"), (["--formats", "gif"], "gif")):
        assert main([*words, *more]) == 1 and told in capsys.readouterr().err


@pytest.mark.parametrize(("display", "opens"), [("", None), (":0", True), (":0", False)])
def test_browsing_serves_until_it_is_interrupted(asked, capsys, monkeypatch, display, opens):
    from aras_visual_servo_bench.web.browse import server as pages

    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.setenv(name, display if name == "DISPLAY" else "")
    seen = [SimpleNamespace(name="s", stored_run_count=3, run_count=9, note="cut off"),
            SimpleNamespace(name="t", stored_run_count=1, run_count=1, note="")]
    found, closed, opened = SimpleNamespace(studies=seen, note="more below"), [], []
    served = SimpleNamespace(studies=SimpleNamespace(read_snapshot=lambda: found),
                             access=SimpleNamespace(address="http://x"),
                             close=lambda: closed.append(1))
    asked(pages, "serve", served)
    monkeypatch.setattr(browse.webbrowser, "open", lambda page: opened.append(page) or opens)

    waited = []

    def wait(_self):
        waited.append(len(closed))
        raise KeyboardInterrupt

    monkeypatch.setattr(browse.threading.Event, "wait", wait)
    assert main(["browse", "d", "e", "--port", "99", "--address", "0.0.0.0"]) == 0
    _, folders, address, port, say = asked.found[0]
    assert (list(map(str, folders)), address, port, closed) == (["d", "e"], "0.0.0.0", 99, [1])
    assert waited == [0]
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:4] == ["s: 3 of 9 runs; cut off", "t: 1 of 1 runs", "more below"]
    assert opened == ([] if opens is None else ["http://x"])
    assert any("cannot open a browser" in line for line in lines) is not (opens is True)
    found.studies, found.note = [], ""
    assert main(["browse", "d", "--no-open"]) == 0 and len(opened) == (opens is not None)
    assert asked.found[-1][2:4] == ("127.0.0.1", 8090)
    assert "no studies yet" in capsys.readouterr().out
    say("hello")
    assert capsys.readouterr().out == "hello\n"
    for port in ("1", "65535"):
        assert main(["browse", "d", "--no-open", "--port", port]) == 0
        assert asked.found[-1][3] == int(port)
    for port in ("0", "65536"):
        assert main(["browse", "d", "--port", port]) == 1
        assert f"--port is {port}, must be 1 to 65535" in capsys.readouterr().err


# -- what is analyzed ------------------------------------------------------------------------------


@pytest.fixture
def bar(monkeypatch):
    """Record what the progress bar shows."""
    shown = []
    monkeypatch.setattr(analyze, "ProgressBar", lambda _stream: SimpleNamespace(
        show=lambda part, what: shown.append((part, what)), close=lambda: shown.append("closed")))
    return shown


@pytest.fixture
def bags(monkeypatch):
    """Replace the reading of bags by a function that returns a named run and reports progress."""
    found = SimpleNamespace(read_bag=lambda path, progress: progress(0.25) or f"bag {path}")
    monkeypatch.setitem(sys.modules, "aras_visual_servo_bench.ros.bag", found)


def test_a_word_names_a_bag_however_it_was_left(bags, tmp_path):
    parts = []
    whole, cut, none = (tmp_path / name for name in ("whole", "cut", "none"))
    for folder, names in ((whole, ("run.bag", "run.bag.active")), (cut, ("run.bag.active",)),
                          (none, ("other.bag",))):
        folder.mkdir()
        for name in names:
            (folder / name).write_text("")
    (tmp_path / "b.bag.active").write_text("")
    for given, read in ((whole, whole / "run.bag"), (cut, cut / "run.bag.active"),
                        (none / "other.bag", none / "other.bag"),
                        (cut / "run.bag", cut / "run.bag.active"),
                        (tmp_path / "b.bag", tmp_path / "b.bag.active")):
        assert load_run(str(given), parts.append) == f"bag {read}"
    assert parts == [0.25] * 5
    for given, why in ((none, f"{none} has no run.bag; for a run of a study give {none}:NUMBER"),
                       (tmp_path / "c.bag", f"there is no file {tmp_path / 'c.bag'}")):
        with pytest.raises(BenchError) as told:
            load_run(str(given), parts.append)
        assert str(told.value) == why


def test_a_word_names_a_study_s_run_or_an_experiment(asked, bags, tmp_path, monkeypatch):
    folder = SimpleNamespace(path=tmp_path / "mine")
    opened = []
    monkeypatch.setattr(folders.StudyFolder, "open", lambda path: opened.append(path) or folder)
    asked(replay, "replay", ("run", {}))
    assert load_run("a/b:12", print) == "run" and str(opened[0]) == "a/b"
    assert asked.found == [("replay", folder, 12, "mine:12")]
    (tmp_path / "x:3").write_text("")
    assert load_run(str(tmp_path / "x:3"), lambda part: None).startswith("bag ")
    for name in ("one.yaml", "two.yml"):
        (tmp_path / name).write_text("plant: free\ngain: 2.5\nduration: 0.1\n")
        run = load_run(tmp_path / name)
        assert (run.name, run.source) == (name[:3], str(tmp_path / name))
        assert (run.experiment.plant, run.experiment.gain) == ("free", 2.5)
    for text, why in (("gain: -1\n", f"{tmp_path / 'one.yaml'}: gain is -1.0"), ("gain: [\n", "")):
        (tmp_path / "one.yaml").write_text(text)
        with pytest.raises(BenchError) as told:
            load_run(str(tmp_path / "one.yaml"), print)
        assert str(told.value).startswith(why) and str(told.value).count("one.yaml") == 1


def test_a_report_tells_what_came_of_each_run(bar, capsys, monkeypatch, tmp_path):
    runs = [SimpleNamespace(name="a", notes=["late", "dark"]), SimpleNamespace(name="b", notes=[])]
    written = []

    def write(*given):
        written.append(given[:4])
        given[4](0.5, "figures")
        if given[1].name == "bad":
            raise BenchError("full")
        return ["page.html", "a.png"]

    monkeypatch.setattr(summary, "summarise", lambda run: f"of {run.name}")
    monkeypatch.setattr(summary, "describe_run", lambda run, found: f"{run.name} {found}")
    monkeypatch.setattr(reports, "write_report", write)
    analyze.write_reports(runs, tmp_path, ("svg",), True)
    said = "\na:\na of a\n  Note: late\n  Note: dark\n\nb:\nb of b\n"
    assert capsys.readouterr().out == said + "\nwrote 2 files; the page is page.html\n"
    assert written == [(runs, tmp_path, ("svg",), True)] and bar == [(0.75, "figures"), "closed"]
    analyze.write_reports(runs, None)
    assert capsys.readouterr().out == said and len(written) == 1
    analyze.write_reports(runs, tmp_path)
    assert written[1][2:] == (("png",), False)
    bar.clear()
    with pytest.raises(BenchError):
        analyze.write_reports(runs, tmp_path / "bad")
    assert bar[-1] == "closed"


def test_a_bag_becomes_a_file_beside_it(bar, capsys, monkeypatch, tmp_path):
    made, bag = [], tmp_path / "my.run.bag"
    bag.write_text("")

    def convert(source, out, progress):
        made.append((source, out))
        progress(0.5)
        if out.name == "bad":
            raise BenchError("full")
        return {"/a": 3, "/b": 4}

    stand_in = SimpleNamespace(convert=convert)
    monkeypatch.setitem(sys.modules, "aras_visual_servo_bench.ros.mcap", stand_in)
    monkeypatch.setattr(aras_visual_servo_bench.ros, "mcap", stand_in, raising=False)
    assert main(["convert", str(bag)]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'my.mcap'}: 7 messages of 2 topics\n"
    assert main(["convert", str(bag), "--out", str(tmp_path / "o")]) == 0
    assert made == [(bag, tmp_path / "my.mcap"), (bag, tmp_path / "o")]
    assert bar[:2] == [(0.5, f"converting {bag}"), "closed"]
    bar.clear()
    assert main(["convert", str(bag), "--out", str(tmp_path / "bad")]) == 1 and bar[-1] == "closed"
    assert main(["convert", str(tmp_path / "none.bag")]) == 1
    assert f"there is no file {tmp_path / 'none.bag'}" in capsys.readouterr().err


def test_a_bag_s_experiment_is_shown_and_kept(capsys, monkeypatch, tmp_path):
    bag, out = tmp_path / "a.bag", tmp_path / "deep" / "er"
    bag.write_text("")
    found = SimpleNamespace(make_mapping=lambda: {"scheme": "points", "goal": [0.1, 0.2]},
                            collect_files=lambda: {"goal.yaml": "depth: 0.2\n", "arm.urdf": "<é/>"},
                            notes=["no start"])
    monkeypatch.setitem(sys.modules, "aras_visual_servo_bench.ros.bag",
                        SimpleNamespace(read_recorded_experiment=lambda path: (
                            found if path == bag else None)))
    told = "scheme: points\ngoal: [0.1, 0.2]\n"
    for more in ([], ["--out", str(out)]):
        assert main(["show", str(bag), *more]) == 0
        assert capsys.readouterr().out == f"{told}# no start\n"
    assert {path.name: path.read_text() for path in out.iterdir()} == {
        "goal.yaml": "depth: 0.2\n", "arm.urdf": "<é/>", "experiment.yaml": told}
    assert main(["show", str(bag), "3"]) == 1
    assert f"{bag} is a bag and contains only one run" in capsys.readouterr().err
    assert main(["show", str(tmp_path)]) == 1
    command = f"rosrun aras_visual_servo_bench bench show {tmp_path} 0"
    assert f"give the number of a run: {command}" in capsys.readouterr().err


def test_a_browser_that_fails_is_no_fault(monkeypatch):
    def fail(_page):
        raise browse.webbrowser.Error

    monkeypatch.setattr(browse.webbrowser, "open", fail)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.setenv("DISPLAY", "")
        monkeypatch.setenv("WAYLAND_DISPLAY", "")
        assert browse._open_browser("x") is False
        monkeypatch.setenv(name, ":0")
        assert browse._open_browser("x") is False
        with monkeypatch.context() as opens:
            opens.setattr(browse.webbrowser, "open", lambda page: page == "x")
            assert browse._open_browser("x") is True


def test_a_candidate_s_study_is_carried_out_in_its_own_folder(asked, study, tmp_path, monkeypatch):
    told, given = [], []

    class Tuner:
        candidates = ()

        def __init__(self, base, ranges, metric, out, carry_out, part):
            self.carry_out, self.base = carry_out, base

        def search(self, evaluations):
            self.carry_out(self.base, tmp_path / "1")
            return SimpleNamespace(values=(), cost=1.0, success=1.0, excursion=0.0, violation=0.0)

        def write(self):
            return "t"

    class Folder:
        def check_code(self):
            told.append("code")

        def count_stored_runs(self):
            return 3

        @contextmanager
        def lock(self):
            told.append("lock")
            yield
            told.append("free")

    class Pool:
        __enter__ = __exit__ = lambda self, *_: None

    monkeypatch.setattr(tuner, "Tuner", Tuner)
    monkeypatch.setattr(run, "make_pool", lambda options: Pool())
    monkeypatch.setattr(
        show_tune.StudyFolder, "create", lambda *made: given.append(made) or Folder()
    )
    monkeypatch.setattr(show_tune, "Progress", lambda *made: SimpleNamespace(
        close=lambda: told.append(made)))
    asked(show_tune.engine, "carry_out")
    assert main(["tune", str(study), "--out", str(tmp_path / "o")]) == 0
    ((path, made, text),) = given
    assert path == tmp_path / "1" and Study.from_mapping(yaml.safe_load(text)).digest == made.digest
    assert list(yaml.safe_load(text)) == list(made.to_mapping())
    assert told == ["code", "lock", (made.run_count, 3), "free"]
    assert len(asked.found) == 1
