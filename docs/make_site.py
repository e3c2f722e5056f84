"""Builds the documentation site into out/site: `.venv/bin/python docs/make_site.py`.

A warning is an error: a page that cannot be reached, a link or picture that is not there, a
docstring that cannot be read. Nothing is fetched from a network.
"""

from __future__ import annotations

import argparse
import gc
import sys
from pathlib import Path

try:
    from sphinx.cmd.build import build_main
except ModuleNotFoundError as error:
    sys.exit(f"{error.name} is missing: run ./setup.sh --for developing first")

ROOT = Path(__file__).resolve().parents[1]


def main(argv: list[str] | None = None) -> int:
    """Build; returns Sphinx's status, 0 where no warning was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/make_site.py --out out/site")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "site", help="folder (out/site)")
    parser.add_argument("--fresh", action="store_true", help="read every page again")
    options = parser.parse_args(argv)
    out = options.out.resolve()
    words = ["-W", "--keep-going", "-q", "-c", str(ROOT / "docs"), "-d", str(out / ".doctrees")]
    words += ["-E"] if options.fresh else []
    gc.set_threshold(100_000, 50, 100)  # Sphinx keeps nearly all: a third of the time was looking
    status = build_main([*words, str(ROOT), str(out)])
    if status == 0:
        print(f"{out}/index.html")
    return status


if __name__ == "__main__":
    sys.exit(main())
