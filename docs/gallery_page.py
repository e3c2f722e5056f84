"""Makes docs/gallery.md and its pictures: every example is carried out and timed.

    PYTHONPATH=$(ls -d src/*/src | paste -sd:) .venv/bin/python docs/gallery_page.py
"""

from __future__ import annotations

import ast
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont, ImageOps

DOCS = Path(__file__).resolve().parent
SCRIPTS = DOCS / "gallery"
IMAGES = DOCS / "images"
# In this order on the page, and on the sheet of the front page.
NAMES = (
    "scheme", "failure", "study", "own_arm", "own_camera", "own_controller", "own_feature",
    "photometric", "moving_target", "noise", "schemes", "from_gazebo", "stereo", "learned",
    "grasp",
)  # fmt: skip
CELL, COLUMNS, EDGE, LETTERS = (300, 210), 5, 10, 26  # pixels; of the sheet
ROUND = 5.0  # s, to which durations are rounded up
HEAD = """# Gallery

Fifteen examples, each a short script and one command: in the workspace's folder after
`./setup.sh` and `source devel/setup.bash; source .venv/bin/activate`, or where `pip install .`
was done. Each leaves its picture and, where it servoes, a report in `out/gallery/NAME`. Times are
of one core of 2026, the start of Python included.
"""


def title(name: str) -> tuple[str, str]:
    """What an example shows: in some words, and in a sentence."""
    text = ast.get_docstring(ast.parse((SCRIPTS / f"{name}.py").read_text(encoding="utf-8")))
    short, _, rest = text.rstrip(".").partition(":")
    return short, rest.strip()[:1].upper() + rest.strip()[1:] + "."


def main() -> int:
    """The page, a picture each, and the sheet."""
    lines, pictures = [HEAD], []
    with tempfile.TemporaryDirectory() as folder:
        for name in NAMES:
            out = Path(folder) / name
            began = time.monotonic()
            subprocess.run([sys.executable, str(SCRIPTS / f"{name}.py"), str(out)], check=True,
                           stdout=subprocess.DEVNULL)  # fmt: skip
            seconds = ROUND * math.ceil((time.monotonic() - began) / ROUND)
            picture = Image.open(out / "picture.png").convert("RGB")
            picture.thumbnail((640, 420), Image.LANCZOS)
            pictures.append(picture)
            kept = IMAGES / f"gallery_{name}.png"
            picture.quantize(128, method=Image.Quantize.FASTOCTREE,
                             dither=Image.Dither.NONE).save(kept, optimize=True)  # fmt: skip
            short, words = title(name)
            lines.append(f"## {short}\n\n{words} About {seconds:.0f} s. "
                         f"[The script](gallery/{name}.py).\n\n```bash\npython "
                         f"docs/gallery/{name}.py\n```\n\n"
                         f"![{short}](images/gallery_{name}.png)\n")  # fmt: skip
            print(f"{name}: {seconds:.0f} s")
    (DOCS / "gallery.md").write_text("\n".join(lines), encoding="utf-8")
    _sheet(pictures).save(IMAGES / "gallery.png", optimize=True)
    return 0


def _sheet(pictures: list[Image.Image]) -> Image.Image:
    """All pictures in one, each with its name above, for the front page."""
    rows = math.ceil(len(pictures) / COLUMNS)
    size = (COLUMNS * (CELL[0] + EDGE) + EDGE, rows * (CELL[1] + EDGE + LETTERS) + EDGE)
    sheet = Image.new("RGB", size, "#ffffff")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
    for i, picture in enumerate(pictures):
        row, column = divmod(i, COLUMNS)
        place = (EDGE + column * (CELL[0] + EDGE), EDGE + row * (CELL[1] + EDGE + LETTERS))
        draw.text(place, title(NAMES[i])[0], "#202124", font)
        sheet.paste(ImageOps.pad(picture, CELL, Image.LANCZOS, "#ffffff"),
                    (place[0], place[1] + LETTERS))  # fmt: skip
    return sheet.quantize(255, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


if __name__ == "__main__":
    sys.exit(main())
