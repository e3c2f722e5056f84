"""What tests/peers makes of a suite's results; the suites themselves are upstream's."""

import importlib.util
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "peer_suites"


@pytest.fixture(scope="module")
def peers():
    spec = importlib.util.spec_from_file_location("peers_cli", FOLDER / "cli.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


RESULTS = """<testsuites><testsuite>
<testcase name="moves" classname="pkg.Arm"/>
<testcase name="stops" classname="pkg.Arm"><failure message="a&#10;  b"/></testcase>
<testcase name="smooth" classname="pkg.Arm"><error>gone</error></testcase>
</testsuite></testsuites>"""


def test_results_are_read_by_name_and_reason(peers, tmp_path):
    (tmp_path / "a.xml").write_text(RESULTS)
    (tmp_path / "b.xml").write_text("<testsuite><testcase")
    passed, failed = peers.read(sorted(tmp_path.iterdir()))
    assert passed == ["Arm.moves"]
    assert failed == {"Arm.stops": "a b", "Arm.smooth": "gone", "b": "its results are broken off"}


def test_the_table_counts_apart_what_cannot_apply(peers):
    suite = peers.Suite("pkg", "test/arm.test", not_applicable={"Arm.smooth": "its hardware's"})
    one = peers.Tried(suite, ("Arm.moves",), {"Arm.stops": "a b", "Arm.smooth": "gone"})
    slow = peers.Suite("pkg", "test/leg.test", parameters={"/arm/delay": 0.1})
    two = peers.Tried(slow, problem="not built")
    text = peers.table([one, two], {"them": "0123456789abcdef"})
    assert "| pkg/arm | 1 | 1; Arm.stops | 1; its hardware's |" in text
    assert "| pkg/leg with `/arm/delay:=0.1` | 0 | not built | 0 |" in text
    assert text.endswith("Sources: them 0123456789ab.")
    assert one.counted == {"Arm.stops": "a b"}


def test_the_table_goes_between_its_marks(peers, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{peers.BEGIN}\nold\n{peers.END}\nafter\n")
    peers.write(page, "new")
    assert page.read_text() == f"before\n{peers.BEGIN}\nnew\n{peers.END}\nafter\n"
    page.write_text("no marks")
    with pytest.raises(ValueError, match="no <!--"):
        peers.write(page, "new")


def test_what_is_known_has_its_stand_ins(peers):
    known = peers.suites()
    assert len({suite.name for suite in known}) == len(known)
    for suite in known:
        assert all((FOLDER / "stand_ins" / name).is_file() for name in suite.stand_ins)


def test_the_first_package_of_a_name_is_taken(peers, tmp_path):
    for folder, name in (("a", " one "), ("b", "one"), ("c/d", "two")):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    assert peers.packages(tmp_path) == {"one": tmp_path / "a", "two": tmp_path / "c/d"}
