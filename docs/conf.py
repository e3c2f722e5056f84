"""Sphinx configuration of the documentation site, which `docs/make_site.py` builds.

The pages are README.md, docs/ and the READMEs of the packages; the API reference comes from the
docstrings. Sphinx reads these files where they are in the repository, so a link between two files
works on GitHub and on the site. Formulas are typeset by KaTeX from Debian's package libjs-katex,
which is copied into the site.
"""

from __future__ import annotations

import html
import importlib
import re
import shutil
import sys
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ConfigError
from sphinx.writers.html5 import HTML5Translator

ROOT = Path(__file__).resolve().parents[1]
KATEX = Path("/usr/share/javascript/katex")  # installed by libjs-katex
sys.path[:0] = [str(folder) for folder in sorted(ROOT.glob("src/aras_*/src"))]

project = "ARAS visual servoing simulator"
author = "its contributors"
html_title = "ARAS visual servoing"
project_copyright = f"{author}, BSD-3-Clause"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath"]  # $...$ and $$...$$, as on GitHub
html_math_renderer = "katex"
root_doc = "README"
include_patterns = [
    "README.md", "CHANGELOG.md", "docs/*.md", "docs/api/*.rst", "src/*/README.md",
    "src/aras_sim_bridge/docs/*.md", "tests/README.md",
]  # fmt: skip
# Folders without pages of the site.
exclude_patterns = [
    ".*", "build", "devel", "install", "out", "docs/images", "docs/examples", "tests/*/**",
    "src/*/src", "src/upstream*",
]  # fmt: skip
nitpicky = False
myst_heading_anchors = 4  # links to headings as on GitHub
suppress_warnings = ["myst.header"]  # a page may start with a heading of any level

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_use_type_comments = False  # the sources have none; searching for them takes time
autodoc_default_options = {"members": True}
add_module_names = False
python_maximum_signature_line_length = 96

html_theme = "furo"
html_static_path = ["site.css", "math.js"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"

# Hidden table of contents that is appended to the first page; the side bar shows it.
CONTENTS = """
```{{toctree}}
:hidden:
:caption: {caption}

{pages}
```
"""
CHAPTERS = {
    "Getting started": (
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
    "Changes": ("CHANGELOG", "docs/moving"),
    "Python API": ("docs/api/bench", "docs/api/controller", "docs/api/camera", "docs/api/bridge"),
}  # fmt: skip


def add_contents(app: Sphinx, name: str, source: list[str]) -> None:
    """Append the table of contents to the first page.

    README.md itself does not contain it, because GitHub would show it as text. A page that does
    not exist is omitted: a checkout can lack docs/schemes.md, whose tables take hours to compute.
    """
    if name == root_doc:
        for caption, pages in CHAPTERS.items():
            existing = [page for page in pages if list(ROOT.glob(f"{page}.*"))]
            source[0] += CONTENTS.format(caption=caption, pages="\n".join(existing))


FIELD = re.compile(r"([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*): +(?=\S)")
SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Yields)\b[^:]*:$")


def convert_docstring(app, what, name, obj, options, lines: list[str]) -> None:
    """Convert a docstring from plain text to reStructuredText, in place.

    Lines "name: description" become a list, both in a section such as "Args:" and elsewhere. Names
    in single backticks become code, and indented paragraphs become examples. All other characters
    with a meaning in reStructuredText are escaped.
    """
    converted: list[str] = []
    field_indent = 0  # column of the fields of the current section
    in_field = in_list = in_example = False
    for line in lines:
        text = line.strip()
        indent = len(line) - len(line.lstrip())
        if not text:
            in_field = in_list = in_example = False
            field_indent = field_indent if field_indent and converted and converted[-1] else 0
            converted.append("")
        elif indent == 0 and SECTION.match(text):
            converted += ["", f"**{text.partition(' ')[0].rstrip(':')}**", ""]
            in_field, in_list, field_indent = False, True, 4
        elif in_example or (
            indent >= 4 > field_indent and not in_field and converted and not converted[-1]
        ):
            in_example = True
            converted.append(line)
        elif in_field and (
            indent > field_indent or (not converted[-1].endswith(".") and not FIELD.match(text))
        ):
            converted.append(f"  {escape_rst(text)}")
        else:
            field = (
                FIELD.match(text) if in_list or (converted and not converted[-1]) else None
            )
            if field:
                names = ", ".join(f"``{part}``" for part in field[1].split(", "))
                text = f"* {names}: {escape_rst(text[field.end() :])}"
            else:
                text = " " * (indent - field_indent) + escape_rst(text)
            if in_field != bool(field):
                converted.append("")
            in_field, in_list = bool(field), in_list or bool(field)
            converted.append(text)
    lines[:] = converted


def escape_rst(line: str) -> str:
    """Escape the characters of a line that reStructuredText would interpret, except backticks."""
    pieces = re.split(r"(`+[^`]+`+)", line)
    pieces[::2] = [re.sub(r"([\\*|]|_(?!\w)|(?<!\w)_)", r"\\\1", text) for text in pieces[::2]]
    pieces[1::2] = [f"``{code.strip('`')}``" for code in pieces[1::2]]
    return "".join(pieces)


PUBLIC = ("aras_visual_servo_bench", "aras_visual_servo_controller", "aras_sim_bridge")


def skip_public(app: Sphinx, what: str, name: str, obj: object, skip: bool, options) -> bool | None:
    """Omit the public names from the page of a module, because that of the package has them."""
    if what != "module" or app.env.temp_data.get("autodoc:module") in PUBLIC:
        return None
    packages = (importlib.import_module(package) for package in PUBLIC)
    return any(name in one.__all__ and getattr(one, name) is obj for one in packages) or None


def write_inline_formula(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula as LaTeX text in a span, which math.js typesets in the browser."""
    translator.body.append(f'<span class="math inline">{html.escape(node.astext())}</span>')
    raise nodes.SkipNode


def write_displayed_formula(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a displayed formula as LaTeX text in a div, which math.js typesets in the browser."""
    translator.body.append(f'<div class="math display">{html.escape(node.astext())}</div>\n')
    raise nodes.SkipNode


def _is_formula(node: nodes.Node) -> bool:
    return isinstance(node, nodes.math | nodes.math_block)


def add_katex(app: Sphinx, name: str, template: str, context: dict, doctree) -> None:
    """Load KaTeX in a page that contains formulas."""
    if doctree is not None and any(doctree.findall(_is_formula)):
        app.add_css_file("katex/katex.min.css")
        app.add_js_file("katex/katex.min.js", loading_method="defer")
        app.add_js_file("math.js", loading_method="defer")


def copy_files(app: Sphinx, error: Exception | None) -> None:
    """Copy KaTeX into the site, and README.html to index.html, the start page."""
    if error is not None:
        return
    out = Path(app.outdir)
    first = out / f"{root_doc}.html"
    if first.is_file():
        shutil.copyfile(first, first.with_name("index.html"))
    katex = out / "_static" / "katex"
    (katex / "fonts").mkdir(parents=True, exist_ok=True)
    for file in ("katex.min.js", "katex.min.css"):
        shutil.copyfile(KATEX / file, katex / file)
    for font in KATEX.glob("fonts/*.woff2"):
        shutil.copyfile(font, katex / "fonts" / font.name)


def setup(app: Sphinx) -> None:
    """Register the functions of this file with Sphinx."""
    if not (KATEX / "katex.min.js").is_file():
        raise ConfigError(f"{KATEX}, which typesets the formulas, is missing: run "
                          "./setup.sh --for developing")  # fmt: skip
    app.add_html_math_renderer(
        "katex", (write_inline_formula, None), (write_displayed_formula, None)
    )
    app.connect("source-read", add_contents)
    app.connect("autodoc-process-docstring", convert_docstring)
    app.connect("autodoc-skip-member", skip_public)
    app.connect("html-page-context", add_katex)
    app.connect("build-finished", copy_files)
