"""Server of the results browser: changing studies, queries, reports, errors."""

import contextlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import time
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import pyarrow.parquet as pq
import pytest
from made_study import made_study, write_chunk

from aras_visual_servo_bench import run_study
from aras_visual_servo_bench.cli import main
from aras_visual_servo_bench.errors import StudyError
from aras_visual_servo_bench.studies.columns import LABEL_COLUMNS
from aras_visual_servo_bench.studies.study_folder import CHECKSUM_FILE, StudyFolder
from aras_visual_servo_bench.web.browse.queries import RunSelection
from aras_visual_servo_bench.web.browse.reports import Reports
from aras_visual_servo_bench.web.browse.result_queries import select_rows
from aras_visual_servo_bench.web.browse.server import BrowseServer, serve
from aras_visual_servo_bench.web.browse.studies import Studies
from aras_visual_servo_bench.web.server import NoFreePortError, start_server

GRID = {"experiment": {"plant": "free", "duration": 0.5},
        "vary": {"gain": [1.0, 4.0, 8.0], "delay": [0.05, 0.2]},
        "repeats": 5, "chunk": 10}  # fmt: skip
HOSTILE = "<img src=x onerror=hit=1>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two studies of one grid with other seeds, one of another, whose key holds text."""
    path = tmp_path_factory.mktemp("studies")
    made_study(path / "first", **GRID)
    made_study(path / "deep" / "second", **GRID, seed=5)
    made_study(path / "words", experiment={"plant": "free"},
               cases={"scheme": [{"name": HOSTILE}, {"name": "points", "set": {"gain": 1.0}}]})
    return path


@pytest.fixture(scope="module")
def served(folder):
    found = serve([folder], "127.0.0.1", 19300 + os.getpid() % 1000, say=lambda _: None)
    yield found
    found.close()


@pytest.fixture(scope="module")
def ask(served):
    return lambda do, **asked: served.answer_query(json.dumps({"do": do, **asked}))


@pytest.fixture(scope="module")
def rows(folder):
    return pq.read_table(folder / "first" / "parts").to_pylist()


def where(*conditions):
    keys = ("column", "operator", "value")
    return [dict(zip(keys, one, strict=False)) for one in conditions]


def test_rows_of_some_studies_that_meet_all_filters_are_given_part_by_part(ask, rows):
    told = ask("studies")
    assert [(s["name"], s["runs"], s["run_count"], s["note"]) for s in told["studies"]] == [
        ("second", 30, 30, ""), ("first", 30, 30, ""), ("words", 2, 2, "")]
    columns = {c["name"]: c for c in told["columns"]}
    assert columns["scheme"]["values"] == [HOSTILE, "points"]
    assert columns["study"]["kind"] == "word" and "code" not in columns
    both = {"studies": ["first"], "filters": where(("gain", ">", 1.0), ("settled", "is known"))}
    wanted = [r for r in rows if r["gain"] > 1.0 and r["settled"] == r["settled"]]
    wanted.sort(key=lambda r: -r["final_distance"])
    told = ask("rows", **both, sort="final_distance", descending=True, first=2, count=3)
    at = list(columns).index("run")
    assert [r[at] for r in told["rows"]] == [r["run"] for r in wanted[2:5]]
    assert (told["total"], told["success_count"]) == (len(wanted), len(wanted))
    assert ask("rows")["total"] == 62
    assert ask("rows", studies=["first", "words"])["total"] == 32


def test_a_run_is_told_with_reason_and_remedy_and_its_whole_seed(ask, rows):
    failed = next(r for r in rows if r["success"] == 0.0)
    row = ask("run", study="first", run=failed["run"])["row"]
    assert (row["reason"], row["remedy"]) == (failed["reason"], failed["remedy"])
    assert int(row["seed"]) == failed["seed"] and row["end"] == "oscillating"
    assert "scheme" not in row  # another study's
    with pytest.raises(StudyError, match="first has no stored result of run 30 yet"):
        ask("run", study="first", run=30)


@pytest.mark.parametrize(("asked", "said"), [
    ({"do": "rows", "filters": where(("gian", "=", 1))}, "no column 'gian'.*'gain'"),
    ({"do": "rows", "filters": where(("gain", "~", 1))}, "operator"),
    ({"do": "rows", "studies": ["../first"]}, "there is no study '../first' in"),
    ({"do": "rows", "count": 100000}, "count"),
    ({"do": "map", "x": "gain", "y": "nothing"}, "no column 'nothing'"),
    ({"do": "rows", "more": 1}, "more"),
    ({"do": "delete"}, "there is no request 'delete'"),
    ([], "JSON object"),
])  # fmt: skip
def test_what_cannot_be_answered_is_one_line(served, asked, said):
    with pytest.raises(Exception, match=said) as raised:
        served.answer_query(json.dumps(asked))
    assert "\n" not in str(raised.value) and not isinstance(raised.value, KeyError)


def test_a_study_that_grows_is_followed_part_by_part(tmp_path, monkeypatch):
    folder = made_study(tmp_path / "grows", range(1), **GRID)
    studies, read, whole = Studies([tmp_path]), [], pq.read_table
    first = studies.read_snapshot(is_forced=True)
    assert (first.studies[0].stored_run_count, first.studies[0].run_count) == (10, 30)
    for name in (".000002.parquet.new", "notes.txt"):  # on its way, and another's
        (folder.find_part(0).parent / name).write_text("")
    assert studies.read_snapshot(is_forced=True) is first
    write_chunk(folder, 2)
    monkeypatch.setattr(pq, "read_table", lambda *a, **k: read.append(1) or whole(*a, **k))
    second = studies.read_snapshot(is_forced=True)
    assert second.version > first.version and second.studies[0].stored_run_count == 20
    assert len(read) == 2  # the new part and its times, none of the old
    made_study(tmp_path / "new", **{**GRID, "seed": 3})
    assert [s.name for s in studies.read_snapshot(is_forced=True).studies] == ["grows", "new"]


def add_broken(path):
    path.mkdir(parents=True)
    (path / "manifest.json").write_text("{")


def test_what_is_damaged_or_gone_is_said_and_the_rest_stays(tmp_path):
    made_study(tmp_path / "good", **GRID)
    bad = made_study(tmp_path / "bad", **{**GRID, "seed": 2})
    studies = Studies([tmp_path])
    assert studies.read_snapshot().table.num_rows == 60
    bad.find_part(1).write_bytes(b"PAR1 nothing")
    add_broken(tmp_path / "broken")
    look = studies.read_snapshot(is_forced=True)
    assert "was changed since it was written" in look.find_study("bad").note
    assert "is not the manifest of a study" in look.find_study("broken").note
    assert look.table.num_rows == 60  # as they were before
    shutil.rmtree(tmp_path / "bad")
    look = studies.read_snapshot(is_forced=True)
    assert look.find_study("bad").note.endswith("bad was removed") and look.table.num_rows == 30


def test_names_that_are_no_text_are_shown_and_asked_for(tmp_path):
    for name in ("st\udcff<b>", "st?<b>", "two\nlines$x$"):  # the first is no UTF-8
        made_study(tmp_path / name, **GRID)
    look = Studies([tmp_path]).read_snapshot()
    names = [one.name for one in look.studies]
    assert len(set(names)) == 3 and "".join(names).encode()
    assert {name.rpartition("/")[2] for name in names} == {"st?<b>", "two\nlines$x$"}
    assert all(select_rows(look, RunSelection((name,))).size == 30 for name in names)


def test_whatever_stands_in_a_folder_the_page_goes_on(tmp_path):
    names = ("good", "deep", "binary sums", "folder of sums", "pipe")
    made = {name: made_study(tmp_path / name, **GRID) for name in names}
    (made["deep"].path / "manifest.json").write_text("[" * 100_000)
    for name in names[2:4]:
        (made[name].path / CHECKSUM_FILE).unlink()
    (made["binary sums"].path / CHECKSUM_FILE).write_bytes(b"\xff\xfe  parts\n")
    (made["folder of sums"].path / CHECKSUM_FILE).mkdir()
    made["pipe"].find_part(0).unlink()
    os.mkfifo(made["pipe"].find_part(0))
    look = Studies([tmp_path]).read_snapshot(is_forced=True)
    assert all(look.find_study(name).note for name in names[1:])
    assert look.find_study("good").stored_run_count == 30 == look.table.num_rows


def test_folders_are_looked_at_once_a_second_and_four_deep(tmp_path_factory, monkeypatch):
    """Links are not followed, nor is a study within another one found."""
    now, tmp_path, outside = [100.0], *(tmp_path_factory.mktemp(name) for name in "ab")
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    add_broken(outside / "secret")
    (tmp_path / "link").symlink_to(outside)
    studies = Studies([tmp_path])
    assert studies.read_snapshot().studies == () and studies.read_snapshot().version == 0
    for place in ("a/b/c/d", "a/b/c/d/e", "a/b/c/z/five"):
        add_broken(tmp_path / place)
    now[0] += 1.0
    assert studies.read_snapshot().studies == ()
    now[0] += 0.01
    assert [seen.name for seen in studies.read_snapshot().studies] == ["d"]
    add_broken(tmp_path / "B")
    assert [seen.name for seen in studies.read_snapshot(is_forced=True).studies] == ["d", "B"]
    for number in range(199):
        add_broken(tmp_path / f"n{number}")
    look = studies.read_snapshot(is_forced=True)
    assert len(look.studies) == 200 and "only the first 200 studies are shown: start" in look.note


def test_columns_of_unlike_studies_of_one_name_stand_below_each_other(tmp_path):
    one = made_study(tmp_path / "a" / "same", experiment={"plant": "free"}, vary={"gain": [1.5, 2]})
    two = made_study(tmp_path / "b" / "same", experiment={"plant": "free"}, vary={"gain": [1, 2]},
                     metrics=["path_ratio"], cases=[{"scheme": "points", "delay": 0.1}])
    look = Studies([tmp_path]).read_snapshot()
    names = look.table.column_names
    assert look.table["study"].to_pylist() == ["same", "same", "b/same", "b/same"]
    assert look.table["gain"].to_pylist() == [1.5, 2.0, 1.0, 2.0]  # whole numbers there
    assert look.table["delay"].to_pylist() == [None, None, 0.1, 0.1]
    assert look.roles["gain"] == look.roles["scheme"] == look.roles["delay"] == "setting"
    measured = {*one.study.metric_names, *two.study.metric_names, "success", "real_time_multiple"}
    assert {name for name in names if look.roles[name] == "metric"} == measured & set(names)
    assert {look.roles[name] for name in ("study", "run", "seed", "end", "outcome")} == {"run"}
    assert [look.units[n] for n in ("gain", "delay", "settled", "simulated", "success")] == [
        "1/s", "s", "s", "s", ""]  # fmt: skip
    assert set(LABEL_COLUMNS) & set(names) == set() and look.version == 1


def get(served, path, body=None, origin=None, token=None):
    joined = "&" if "?" in path else "?"
    token = served.access.token if token is None else token
    address = f"http://127.0.0.1:{served.access.port}{path}{joined}token={token}"
    asked = Request(address, data=body, headers={"Origin": origin} if origin else {})
    try:
        with urlopen(asked, timeout=60) as answer:
            return answer.status, answer.read().decode(), dict(answer.headers)
    except HTTPError as error:
        return error.code, error.read().decode(), dict(error.headers)


def test_only_who_has_the_token_is_answered(served):
    body = b'{"do": "studies"}'
    assert get(served, "/ask", body)[0] == 200
    assert get(served, "/ask", body, origin="http://elsewhere.org")[0] == 403
    for path, sent in (("/ask", body), ("/run?study=first&run=0", None), ("/", None)):
        assert get(served, path, sent, token=served.access.token[:-1])[0] == 403
    status, page, headers = get(served, "/")
    assert status == 200 and "script-src 'self'" in headers["Content-Security-Policy"]
    assert get(served, "/ask", b"[" * 60000)[0] == 400
    with contextlib.suppress(ConnectionError):  # it hangs up while that is still being sent
        assert get(served, "/ask", b"x" * 70000)[0] == 400


def test_a_status_says_whose_fault_it_was(served, folder, caplog):
    """400: of the question; 500: of the server, which tells its page and goes on."""
    class Faulty(BrowseServer):
        def answer_query(self, text):
            raise KeyError("gain")

    status, text, _ = get(served, "/ask", b'{"do": "dance"}')
    assert status == 400 and "dance" in json.loads(text)["error"]
    faulty = start_server(lambda access, sockets: Faulty(Studies([folder]), access, sockets),
                          "the results browser", "read", "127.0.0.1", 19400, "", lambda _: None)
    with contextlib.closing(faulty):
        for _ in range(2):
            status, text, headers = get(faulty, "/ask", b'{"do": "studies"}')
            assert (status, json.loads(text)) == (500, {"error": "KeyError: 'gain'"})
            assert headers["Content-Type"] == "application/json" and "studies" in caplog.text


@pytest.mark.parametrize(("study", "run", "said"), [
    ("first", "../../etc/passwd", "must have 1 to 9 digits"),
    ("first", "9" * 10, "must have 1 to 9 digits"),
    ("first", "9" * 9, "first has no run 999999999"), ("first", "30", "first has no run 30"),
    ("first", "٣", "must have 1 to 9 digits"), (HOSTILE, "1", "there is no study"),
])  # fmt: skip
def test_a_report_that_cannot_be_is_said_without_markup(served, study, run, said):
    status, text, _ = get(served, f"/run?{urlencode({'study': study, 'run': run})}")
    assert said in text
    assert status == 400 and 'id="waiting"' in text
    assert "<img" not in text and "Traceback" not in text


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    path = tmp_path_factory.mktemp("real") / "real study"
    run_study({"experiment": {"plant": "free", "duration": 0.2, "lag": 0.0},
               "vary": {"gain": [2.0, 4.0]}, "chunk": 1}, path, progress=False)  # fmt: skip
    return StudyFolder.open(path)


@pytest.fixture
def seen(real):
    return Studies([real.path]).read_snapshot().studies[0]


def wait_for_report(reports, seen, run):
    end = time.monotonic() + 300.0
    while isinstance(found := reports.find_or_start(seen, run), float):
        assert time.monotonic() < end
        time.sleep(0.1)
    return found


def test_a_report_is_computed_again_only_where_the_row_is_newer(real, seen, monkeypatch, program):
    """What the real program writes: test_browse_browser."""
    part, page = real.find_part(1), real.path / "show-1" / "report.html"
    program('sleep 0.2; mkdir "$6"; echo "$*" > "$6/report.html"')
    with contextlib.closing(Reports()) as reports:
        assert reports.find_or_start(seen, 1) == 0.0
        assert wait_for_report(reports, seen, 1) == page
    words = f"-m aras_visual_servo_bench analyze {real.path}:1 --out {page.parent} --formats \n"
    assert page.read_text() == words
    with monkeypatch.context() as held:
        held.setattr(subprocess, "Popen", None)  # not computed again
        assert Reports().find_or_start(seen, 1) == page
        os.utime(part, ns=(page.stat().st_mtime_ns,) * 2)
        assert Reports().find_or_start(seen, 1) == page
    os.utime(part, (time.time() + 5, time.time() + 5))
    with contextlib.closing(Reports()) as again:
        assert again.find_or_start(seen, 1) == 0.0
    os.utime(part)


def test_a_report_outside_of_the_folder_is_not_given(real, seen, tmp_path):
    (tmp_path / "report.html").write_text("secret")
    (real.path / "show-0").symlink_to(tmp_path)
    with contextlib.closing(Reports()) as reports:
        assert reports.find_or_start(seen, 0) == 0.0
        (job,) = reports.jobs.values()
        assert not job.out.resolve().is_relative_to(tmp_path)  # nothing is written there either
    (real.path / "show-0").unlink()


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Function that sets a shell script that runs instead of the program of a report."""
    path = tmp_path / "python"
    monkeypatch.setattr(sys, "executable", str(path))
    path.touch(0o755)
    return lambda text: path.write_text(f"#!/bin/sh\n{text}\n")


def test_reports_of_a_folder_that_cannot_be_written_have_a_folder_each(
    real, seen, monkeypatch, program, capfd
):  # fmt: skip
    monkeypatch.setattr(os, "access", lambda *_: False)
    program("echo first >&2\necho 'bench: so it is' >&2\necho other\nexit 3")
    with contextlib.closing(Reports()) as reports:
        outs = [reports.start_job(seen, run).out for run in (0, 1)]
        reports.find_or_start(seen, 1)
        with pytest.raises(StudyError, match="report of run 1 could not be made: so it is$"):
            wait_for_report(reports, seen, 1)
        assert capfd.readouterr() == ("", "")
        outs.append(reports.start_job(seen, 2).out)
    assert len(set(outs)) == 3 and not any(out.is_relative_to(real.path) for out in outs)


def test_too_many_reports_at_once_and_one_that_fails_are_said(folder, program):
    seen = Studies([folder]).read_snapshot(is_forced=True).studies[0]
    program("exit 1")
    with contextlib.closing(Reports()) as reports:
        with pytest.raises(StudyError, match="of run 0 could not .*: its process ended with 1"):
            wait_for_report(reports, seen, 0)
        program("exec sleep 100")
        assert [reports.find_or_start(seen, run) for run in (0, 1)] == [0.0, 0.0]
        with pytest.raises(StudyError, match="^2 reports are being computed: wait"):
            reports.find_or_start(seen, 2)
        job = next(iter(reports.jobs.values()))
        job.process.kill()
        job.process.wait()
        assert reports.find_or_start(seen, 2) == 0.0  # it is over, though nobody asked for it


def test_a_folder_or_an_address_that_is_none_is_named(folder, capsys):
    with pytest.raises(NoFreePortError, match="use an address of this machine"):
        serve([folder], "192.0.2.1", 19100, say=lambda _: None)
    assert main(["browse", str(folder / "none"), "--no-open"]) == 1
    assert f"there is no folder {folder / 'none'}" in capsys.readouterr().err


def test_the_command_opens_the_page_in_a_browser_and_ends_by_interrupt(folder, tmp_path):
    opened, browser = tmp_path / "opened", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" > {opened}\n')
    browser.chmod(0o755)
    program = """import os, sys
from aras_visual_servo_bench.cli import main
for os.environ["DISPLAY"], *more in (":0",), (":0", "--no-open"), ("",):
    print("status", main(["browse", sys.argv[1], *more]), flush=True)
"""
    child = subprocess.Popen(
        [sys.executable, "-c", program, str(folder)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**{k: v for k, v in os.environ.items() if "DISPLAY" not in k},
             "BROWSER": str(browser), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    try:
        for is_opened, is_display in ((True, True), (False, True), (False, False)):
            text = "".join(itertools.takewhile(lambda line: "Ctrl-C" not in line, child.stdout))
            address = re.search(r"at (http://127\.0\.0\.1:\d+/\?token=\S+)", text)
            assert address and "first: 30 of 30 runs" in text
            assert ("cannot open a browser" in text) is not is_display
            assert opened.exists() is is_opened
            if is_opened:
                assert opened.read_text().strip() == address[1]
                opened.unlink()
            with urlopen(address[1], timeout=20) as answer:
                assert answer.status == 200
            child.send_signal(2)
            assert child.stdout.readline() == "status 0\n"
        assert child.wait(20) == 0
    finally:
        child.kill()
        child.wait()
    assert "Traceback" not in child.stderr.read()


def test_two_studies_are_compared(ask):
    """Their numbers: unit/study/test_recomputed.py."""
    told = ask("compare", first="first", second="second")["differences"]
    assert not any(d["is_significant"] for d in told)  # the same numbers by luck
    tested = [d["p"] for d in told if d["verdict"] == "chance"]
    assert tested and sorted(tested) == [d["p"] for d in told[:len(tested)]]
    same = ask("compare", first="first", second="first", by=["gain"])["differences"]
    assert all(d["paired"] and d["before"] == d["after"] for d in same if d["before"] is not None)
