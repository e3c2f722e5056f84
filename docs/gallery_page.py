"""Generate docs/gallery.md and its pictures: run and time every example.

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
# Order on the page and in the overview picture of the front page.
NAMES = (
    "scheme", "failure", "study", "own_arm", "own_camera", "own_controller", "own_feature",
    "photometric", "moving_target", "noise", "schemes", "from_gazebo", "stereo", "learned",
    "grasp", "two_arms", "public_robot", "calibration",
)  # fmt: skip
CELL, COLUMNS, EDGE, LETTERS = (300, 210), 6, 10, 26  # of the overview picture, px
ROUND = 5.0  # s; durations are rounded up to multiples of this
HEAD = """# Gallery

Each example is a short script that writes a picture and, if it servoes, a report to the folder
`out/gallery/NAME`. Run the commands in the folder of the workspace, after `./setup.sh` and `source
devel/setup.bash; source .venv/bin/activate`, or after `pip install .`. The durations are those of
one core of a computer of 2026 and include the start of Python.
"""


def title(name: str) -> tuple[str, str]:
    """Return the title of an example and a sentence about it, from its docstring."""
    text = ast.get_docstring(ast.parse((SCRIPTS / f"{name}.py").read_text(encoding="utf-8")))
    short, _, rest = " ".join(text.split()).rstrip(".").partition(":")
    return short, rest.strip()[:1].upper() + rest.strip()[1:] + "."


def main() -> int:
    """Write the page, one picture per example, and the overview picture."""
    lines, pictures = [HEAD], []
    with tempfile.TemporaryDirectory() as folder:
        for name in NAMES:
            out = Path(folder) / name
            start = time.monotonic()
            subprocess.run([sys.executable, str(SCRIPTS / f"{name}.py"), str(out)], check=True,
                           stdout=subprocess.DEVNULL)  # fmt: skip
            seconds = ROUND * math.ceil((time.monotonic() - start) / ROUND)
            picture = Image.open(out / "picture.png").convert("RGB")
            picture.thumbnail((640, 420), Image.LANCZOS)
            pictures.append(picture)
            target = IMAGES / f"gallery_{name}.png"
            picture.quantize(128, method=Image.Quantize.FASTOCTREE,
                             dither=Image.Dither.NONE).save(target, optimize=True)  # fmt: skip
            short, sentence = title(name)
            lines.append(f"## {short}\n\n{sentence} The example takes about "
                         f"{seconds:.0f} s. [The script](gallery/{name}.py).\n\n```bash\npython "
                         f"docs/gallery/{name}.py\n```\n\n"
                         f"![{short}](images/gallery_{name}.png)\n")  # fmt: skip
            print(f"{name}: {seconds:.0f} s")
    (DOCS / "gallery.md").write_text("\n".join(lines), encoding="utf-8")
    _sheet(pictures).save(IMAGES / "gallery.png", optimize=True)
    return 0


def _sheet(pictures: list[Image.Image]) -> Image.Image:
    """Return the overview picture: all pictures with their titles."""
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
