"""The documentation site: README, docs/ and the packages' READMEs as they are, API from docstrings.

Nothing is copied: Sphinx reads the checkout itself and takes the pages named below, so that links
hold on the site as they do in the files. `docs/make_site.py` calls it.
"""

from __future__ import annotations

import importlib
import re
import shutil
import sys
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(folder) for folder in sorted(ROOT.glob("src/aras_*/src"))]

project = "ARAS visual servoing simulator"
author = "its contributors"
html_title = "ARAS visual servoing"
project_copyright = f"{author}, BSD-3-Clause"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
root_doc = "README"
include_patterns = [
    "README.md", "CHANGELOG.md", "docs/*.md", "docs/api/*.rst", "src/*/README.md",
    "src/aras_sim_bridge/docs/*.md", "tests/README.md",
]  # fmt: skip
# Folders that Sphinx would look through in vain.
exclude_patterns = [
    ".*", "build", "devel", "install", "out", "docs/images", "docs/examples", "tests/*/**",
    "src/*/src", "src/upstream*",
]  # fmt: skip
nitpicky = False
myst_heading_anchors = 4  # links to headings as on GitHub
suppress_warnings = ["myst.header"]  # a package's README is a page of its own: its levels are free

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_use_type_comments = False  # there are none to look for
autodoc_default_options = {"members": True}
add_module_names = False
python_maximum_signature_line_length = 96

html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"

# The reading order; README is the first page and shows none of this.
CONTENTS = """
```{{toctree}}
:hidden:
:caption: {caption}

{pages}
```
"""
CHAPTERS = {
    "The first hour": (
        "docs/first_run", "docs/gallery", "docs/my_scheme", "docs/my_robot", "docs/my_camera",
        "docs/several_cameras", "docs/my_target", "docs/solid_targets", "docs/studies",
        "docs/browsing",
        "docs/learning", "docs/reading_results", "docs/installing",
    ),
    "Coming from Gazebo": ("docs/porting", "docs/differences"),
    "Theory": (
        "docs/theory", "docs/schemes", "docs/moments", "docs/camera", "docs/step_response",
        "docs/truth",
    ),
    "Reference": (
        "docs/packages", "docs/adding", "docs/topics", "docs/scheme_interface",
        "src/aras_visual_servo_gazebo/README", "src/aras_sim_bridge/README",
        "src/aras_sim_bridge/docs/camera", "src/aras_visual_servo_camera/README",
        "src/aras_visual_servo_controller/README", "src/aras_visual_servo_bench/README",
        "src/aras_visual_servo_base/README", "src/aras_visual_servo_ros/README", "tests/README",
    ),
    "What changed": ("CHANGELOG", "docs/moving"),
    "Python API": ("docs/api/bench", "docs/api/controller", "docs/api/camera", "docs/api/bridge"),
}  # fmt: skip


def add_contents(app: Sphinx, name: str, source: list[str]) -> None:
    """The reading order goes to the end of the first page, whose file is to be read on its own.

    A page that is not there is left out: docs/schemes.md is made of tables that take hours.
    """
    if name == root_doc:
        for caption, pages in CHAPTERS.items():
            there = [page for page in pages if list(ROOT.glob(f"{page}.*"))]
            source[0] += CONTENTS.format(caption=caption, pages="\n".join(there))


FIELD = re.compile(r"([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*): +(?=\S)")
SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Yields)\b[^:]*:$")


def plain(app, what, name, obj, options, lines: list[str]) -> None:
    """Our docstrings are plain text: what reStructuredText would take for marks is kept as it is.

    Lines "name: what it is" become a list, in a section ("Args:") as outside of one; names in
    single backticks are code; what is indented by itself is an example.
    """
    made: list[str] = []
    left = 0  # column at which fields begin
    item = listing = False  # within a field; among fields
    example = False
    for line in lines:
        text = line.strip()
        indent = len(line) - len(line.lstrip())
        if not text:
            item = listing = example = False
            left = left if left and made and made[-1] else 0
            made.append("")
        elif indent == 0 and SECTION.match(text):
            made += ["", f"**{text.partition(' ')[0].rstrip(':')}**", ""]
            item, listing, left = False, True, 4
        elif example or (indent >= 4 > left and not item and made and not made[-1]):
            example = True
            made.append(line)
        elif item and (indent > left or (not made[-1].endswith(".") and not FIELD.match(text))):
            made.append(f"  {escaped(text)}")
        else:
            field = FIELD.match(text) if listing or (made and not made[-1]) else None
            if field:
                names = ", ".join(f"``{part}``" for part in field[1].split(", "))
                text = f"* {names}: {escaped(text[field.end() :])}"
            else:
                text = " " * (indent - left) + escaped(text)
            if item != bool(field):
                made.append("")
            item, listing = bool(field), listing or bool(field)
            made.append(text)
    lines[:] = made


def escaped(line: str) -> str:
    """Without reStructuredText's marks."""
    pieces = re.split(r"(`+[^`]+`+)", line)
    pieces[::2] = [re.sub(r"([\\*|]|_(?!\w)|(?<!\w)_)", r"\\\1", text) for text in pieces[::2]]
    pieces[1::2] = [f"``{code.strip('`')}``" for code in pieces[1::2]]
    return "".join(pieces)


PUBLIC = ("aras_visual_servo_bench", "aras_visual_servo_controller", "aras_sim_bridge")


def skip_public(app: Sphinx, what: str, name: str, obj: object, skip: bool, options) -> bool | None:
    """Public names are documented once, with their package, and not again with their module."""
    if what != "module" or app.env.temp_data.get("autodoc:module") in PUBLIC:
        return None
    packages = (importlib.import_module(package) for package in PUBLIC)
    return any(name in one.__all__ and getattr(one, name) is obj for one in packages) or None


def copy_first_page(app: Sphinx, error: Exception | None) -> None:
    """README.html is what a browser asks for as index.html."""
    first = Path(app.outdir) / f"{root_doc}.html"
    if error is None and first.is_file():
        shutil.copyfile(first, first.with_name("index.html"))


def setup(app: Sphinx) -> None:
    """Sphinx's hook."""
    app.connect("source-read", add_contents)
    app.connect("autodoc-process-docstring", plain)
    app.connect("autodoc-skip-member", skip_public)
    app.connect("build-finished", copy_first_page)
