"""Makes the pictures of reports and studies for the documentation: run by hand, needs Chromium.

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
    """Of reports report.png, comparison.png and a figure; first_study.png, browser.png."""
    chromium = next(filter(None, map(shutil.which, BROWSERS)), "")
    if not chromium:
        print("no Chromium: sudo apt install chromium", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        _reports(chromium, Path(folder))
        _studies(chromium, Path(folder))
    return 0


def _reports(chromium: str, out: Path) -> None:
    records = [run_with_images(experiment, name) for name, experiment in RUNS.items()]
    write_report(records[:1], out / "one", ("png", "svg"))
    write_report(records, out / "all", ())
    _kept(out / "one" / "figures" / "feature_errors.png", "feature_errors.png", 900)
    for name, kind, height in (("report.png", "one", 2000), ("comparison.png", "all", 1700)):
        address = (out / kind / "report.html").as_uri() + "#at=0.4"
        _kept(_seen(chromium, address, height, out / name), name, 1000)


def _studies(chromium: str, out: Path) -> None:
    """The first study's map, and the results browser with a run of it open."""
    for name, changed in (("first", ()), ("points", ("scheme=points",))):
        bench(["run", "first", *changed, "--out", str(out / "studies" / name)])
    _kept(out / "studies" / "first" / "plots" / "success.png", "first_study.png", 900)
    view = {"filters": [["gain", "≥", 2]], "run": ["first", 70], "sort": "success"}
    server = serve([out / "studies"], "127.0.0.1", 18090)
    try:
        address = f"{server.access.address}#{quote(json.dumps(view))}"
        _kept(_seen(chromium, address, 1250, out / "browser.png"), "browser.png", 1100)
    finally:
        server.close()


def _seen(chromium: str, address: str, height: int, shot: Path) -> Path:
    """A picture of a page, 1440 pixels wide."""
    subprocess.run(
        [chromium, "--headless", "--no-sandbox", "--hide-scrollbars",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--virtual-time-budget=8000",
         f"--window-size=1440,{height}", f"--screenshot={shot}", address],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    return shot


def _kept(source: Path, name: str, width: int) -> None:
    picture = Image.open(source).convert("RGB")
    picture = picture.resize((width, round(picture.height * width / picture.width)), Image.LANCZOS)
    kept = IMAGES / name
    # 256 colours look the same at half the size, if chosen by an octree: a median cut loses those
    # of thin curves.
    few = picture.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(kept, optimize=True)
    print(f"{kept}: {kept.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
