"""Makes the pictures of a report for the documentation: run by hand, needs Chromium.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/report_pictures.py
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from aras_visual_servo_bench.asked.experiment import Experiment
from aras_visual_servo_bench.report.write import write_report
from aras_visual_servo_bench.study.replay import carried_out

IMAGES = Path(__file__).resolve().parent / "images"
BROWSERS = ("chromium", "chromium-headless-shell", "chromium-browser", "chrome")
RUNS = {
    "gain 5": Experiment(start="2016"),
    "gain 2": Experiment(start="2016", gain=2.0),
    "points": Experiment(start="2016", scheme="points"),
}


def main() -> int:
    """report.png and comparison.png, of a page each, and the figure of the README."""
    chromium = next(filter(None, map(shutil.which, BROWSERS)), "")
    if not chromium:
        print("no Chromium: sudo apt install chromium", file=sys.stderr)
        return 1
    records = [carried_out(name, experiment) for name, experiment in RUNS.items()]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        write_report(records[:1], out / "one", ("png", "svg"))
        write_report(records, out / "all", ())
        _kept(out / "one" / "figures" / "feature_errors.png", "feature_errors.png", 900)
        for name, kind, height in (("report.png", "one", 2000), ("comparison.png", "all", 1700)):
            shot = out / name
            subprocess.run(
                [chromium, "--headless", "--no-sandbox", "--hide-scrollbars",
                 "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
                 "--virtual-time-budget=8000", f"--window-size=1440,{height}",
                 f"--screenshot={shot}", (out / kind / "report.html").as_uri() + "#at=0.4"],
                check=True, capture_output=True, timeout=120,
            )  # fmt: skip
            _kept(shot, name, 1000)
    return 0


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
