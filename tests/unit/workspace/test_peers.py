"""Evaluation of the results of tests/peers."""

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "peer_suites"
COMMIT = "0123456789abcdef"


def module_of(name):
    """Import a module of the command, which imports modules of its own folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        return importlib.import_module(name)


@pytest.fixture(scope="module")
def peers():
    return module_of("cli")


@pytest.fixture(scope="module")
def packages():
    return module_of("packages")


def test_results_are_read_by_name_and_reason(peers, tmp_path):
    (tmp_path / "a.xml").write_text("""<testsuites><testsuite>
        <testcase name="moves" classname="pkg.Arm"/><testcase name="stops" classname="pkg.Arm">
        <failure message="a&#10;  b"/></testcase><testcase name="smooth" classname="pkg.Arm">
        <error>gone</error></testcase></testsuite></testsuites>""")
    (tmp_path / "b.xml").write_text("<testsuite><testcase")
    passed, failed = peers.read(sorted(tmp_path.iterdir()))
    assert passed == ["Arm.moves"]
    assert failed == {"Arm.stops": "a b", "Arm.smooth": "gone", "b": "its results are broken off"}


def test_the_tables_count_apart_what_cannot_apply_and_go_between_their_marks(
    peers, packages, tmp_path
):
    suite = peers.Suite("pkg", "test/arm.test", not_applicable={"Arm.smooth": "its hardware's"})
    one = peers.Tried(suite, ("Arm.moves",), {"Arm.stops": "a b", "Arm.smooth": "gone"})
    slow = peers.Suite("pkg", "test/leg.test", parameters={"/arm/delay": 0.1})
    text = peers.table([one, peers.Tried(slow, problem="not built")], {"them": COMMIT})
    assert "| pkg/arm | 1 | 1; Arm.stops | 1; its hardware's |" in text
    assert "| pkg/leg with `/arm/delay:=0.1` | 0 | not built | 0 |" in text
    assert text.endswith("Sources: them 0123456789ab.") and one.counted == {"Arm.stops": "a b"}

    good = packages.Package("a", {"o/r": COMMIT}, "a a.launch", not_served=["libx.so"])
    bad = packages.Package("b", {"o/r": COMMIT}, "b b.launch")
    text = packages.table(
        [packages.Result(good, ["arm"]), packages.Result(bad, [], ["no | clock"])])
    assert text.startswith("1 of 2 packages start, and all their supported parts work.")
    assert "| a | `a a.launch` | arm | - | `libx.so` |" in text
    assert "| b | `b b.launch` | - | no / clock | - |" in text
    assert text.endswith("Sources: o/r 0123456789ab.")

    page, write = tmp_path / "page.md", module_of("page").write
    page.write_text("before\n<!-- a -->\nold\n<!-- /a -->\n<!-- b -->\n<!-- /b -->\n")
    write(page, "a", "new")
    assert page.read_text() == "before\n<!-- a -->\nnew\n<!-- /a -->\n<!-- b -->\n<!-- /b -->\n"
    page.write_text("no marks")
    with pytest.raises(ValueError, match="no <!-- a -->"):
        write(page, "a", "new")


def test_suites_and_packages_are_complete_and_can_be_fetched(peers, packages, tmp_path):
    known = peers.suites()
    assert len({suite.name for suite in known}) == len(known)
    for suite in known:
        assert all((FOLDER / "stand_ins" / name).is_file() for name in suite.stand_ins)
    for folder, name in (("a", " one "), ("b", "one"), ("c/d", "two")):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    # the first one of a name is taken
    assert peers.packages(tmp_path) == {"one": tmp_path / "a", "two": tmp_path / "c/d"}
    known = packages.known_packages(FOLDER / "packages.yaml")
    assert len({one.name for one in known}) == len(known) >= 28
    for one in known:
        checkouts = {repo.partition("/")[2] for repo in one.repositories}
        assert all(len(commit) == 40 for commit in one.repositories.values())
        assert one.models or one.services
        assert {folder.partition("/")[0] for folder in one.folders} <= checkouts
    commands = packages.clone_commands([packages.Package("p", {"o/r": "0123"}, "x y")] * 2)
    assert commands == ["git clone https://github.com/o/r && git -C r checkout 0123"]


def test_a_part_that_is_not_served_has_to_be_named_in_one_line(packages, tmp_path):
    warnings = ["model 'm': <gazebo>: plugin 'libx.so' is ignored, because it is not known",
                "liby.so here", "liby.so there"]  # fmt: skip
    (tmp_path / "output").write_text("\n".join([
        "process[gazebo-2]: started with pid 7", "[INFO] [/gazebo] libz.so is there",
        *(f"[WARN] [/gazebo] {text}" for text in warnings),
        "\x1b[31mERROR: cannot launch node of type [a/b]: a\x1b[0m"]))  # fmt: skip
    lines = packages.plain_lines(tmp_path / "output")
    one = packages.Package("p", {}, "a b.launch", not_served=["libx.so", "a/b", "liby.so", "libz"])
    assert packages.unnamed(one, lines) == ["'liby.so' is named in 2 lines of the log",
                                            "'libz' is named in 0 lines of the log"]
    assert packages.warnings_of(lines) == warnings


def test_a_package_sees_its_own_folders_first_and_no_display(packages, tmp_path, monkeypatch):
    for name, value in (("ROS_PACKAGE_PATH", "/ours"), ("PYTHONPATH", "/ours"), ("DISPLAY", ":0")):
        monkeypatch.setenv(name, value)
    (tmp_path / "r" / "pkg").mkdir(parents=True)
    for name in ("setup.py", "package.xml"):
        (tmp_path / "r" / "pkg" / name).touch()
    one = packages.Package("p", {"o/r": "0123"}, "x y", environment={"PLACE": "{sources}/r"})
    found = packages.environment_of(one, tmp_path, tmp_path / "keep", 7)
    assert found["ROS_PACKAGE_PATH"] == f"{tmp_path}/r:/ours"
    assert found["PYTHONPATH"] == f"{tmp_path}/r/pkg/src:/ours"
    assert found["PLACE"] == f"{tmp_path}/r" and "DISPLAY" not in found
    assert found["ROS_MASTER_URI"] == "http://127.0.0.1:7"
