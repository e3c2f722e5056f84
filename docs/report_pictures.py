"""Write the documentation's pictures of reports and studies; needs Chromium.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/report_pictures.py
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import quote

from PIL import Image

from aras_visual_servo_bench import run_with_images
from aras_visual_servo_bench.cli import main as bench
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.web.browse.server import serve
from aras_visual_servo_bench.web.report.write import write_report

IMAGES = Path(__file__).resolve().parent / "images"
BROWSERS = ("chromium", "chromium-headless-shell", "chromium-browser", "chrome")
RUNS = {
    "gain 5": Experiment(start="2016"),
    "gain 2": Experiment(start="2016", gain=2.0),
    "points": Experiment(start="2016", scheme="points"),
}


def main() -> int:
    """Write report.png, comparison.png, a figure, first_study.png and browser.png."""
    chromium = next(filter(None, map(shutil.which, BROWSERS)), "")
    if not chromium:
        print("Chromium is missing: sudo apt install chromium", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        _reports(chromium, Path(folder))
        _studies(chromium, Path(folder))
    return 0


def _reports(chromium: str, out: Path) -> None:
    records = [run_with_images(experiment, name) for name, experiment in RUNS.items()]
    write_report(records[:1], out / "one", ("png", "svg"))
    write_report(records, out / "all", ())
    _save(out / "one" / "figures" / "feature_errors.png", "feature_errors.png", 900)
    for name, kind, height in (("report.png", "one", 2000), ("comparison.png", "all", 1700)):
        address = (out / kind / "report.html").as_uri() + "#at=0.4"
        _save(_take_screenshot(chromium, address, height, out / name), name, 1000)


def _studies(chromium: str, out: Path) -> None:
    """Write the map of the first study, and the results browser with one run selected."""
    for name, changed in (("first", ()), ("points", ("scheme=points",))):
        bench(["run", "first", *changed, "--out", str(out / "studies" / name)])
    _save(out / "studies" / "first" / "plots" / "success.png", "first_study.png", 900)
    view = {"filters": [["gain", "≥", 2]], "run": ["first", 70], "sort": "success"}
    server = serve([out / "studies"], "127.0.0.1", 18090)
    try:
        address = f"{server.access.address}#{quote(json.dumps(view))}"
        _save(_take_screenshot(chromium, address, 1250, out / "browser.png"), "browser.png", 1100)
    finally:
        server.close()


def _take_screenshot(chromium: str, address: str, height: int, shot: Path) -> Path:
    """Save a screenshot of a page, 1440 px wide, and return its path."""
    subprocess.run(
        [chromium, "--headless", "--no-sandbox", "--hide-scrollbars",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--virtual-time-budget=8000",
         f"--window-size=1440,{height}", f"--screenshot={shot}", address],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    return shot


def _save(source: Path, name: str, width: int) -> None:
    picture = Image.open(source).convert("RGB")
    picture = picture.resize((width, round(picture.height * width / picture.width)), Image.LANCZOS)
    target = IMAGES / name
    # A palette of 256 colours halves the file size without visible difference. The octree keeps
    # the colours of thin curves, a median cut does not.
    few = picture.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(target, optimize=True)
    print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
