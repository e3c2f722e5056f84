"""The first study of the documentation is the shipped one, and its commands exist."""

import re
from pathlib import Path

import pytest

from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.metrics import metrics
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.studies.study_execution import check_study

ROOT = Path(__file__).resolve().parents[3]
DOCS = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
SHIPPED = ROOT / "src/aras_visual_servo_bench/config/studies"


def test_the_first_study_is_five_lines():
    """The gallery's example carries it out."""
    text = re.search(r"```yaml\n(.*?)```", DOCS, re.DOTALL)[1]
    assert text.count("\n") == 5
    assert text == (SHIPPED / "first.yaml").read_text(encoding="utf-8")
    assert "bench run first.yaml --out first\n" in DOCS


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_studies_can_be_run(path):
    check_study(Study.from_yaml(path))


def test_shipped_studies_metrics_and_keys_are_in_the_documentation():
    assert find_study_file(Path("decay")) == SHIPPED / "decay.yaml"
    assert all(f"| `{path.stem}` |" in DOCS for path in SHIPPED.glob("*.yaml"))
    assert all(f"`{name}`" in DOCS for name in (*metrics.METRICS, *Study.__dataclass_fields__))
