"""Build the documentation site in out/site.

    .venv/bin/python docs/make_site.py

Every warning is an error, for example a page that is in no chapter, a link to a missing file, or a
docstring that cannot be converted. Neither the build nor the finished site needs a network.
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
    """Build the site and return the status of Sphinx, which is 0 if there was no warning."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0],
                                     epilog="example: docs/make_site.py --out out/site")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "site",
                        help="output folder (default out/site)")
    parser.add_argument("--fresh", action="store_true",
                        help="read every page again, also those that have not changed")
    options = parser.parse_args(argv)
    out = options.out.resolve()
    arguments = ["-W", "--keep-going", "-q", "-c", str(ROOT / "docs"), "-d", str(out / ".doctrees")]
    arguments += ["-E"] if options.fresh else []
    # Sphinx keeps almost all objects; with the default thresholds the garbage collector takes a
    # third of the time.
    thresholds = gc.get_threshold()
    gc.set_threshold(1_000_000, 50, 100)
    status = build_main([*arguments, str(ROOT), str(out)])
    gc.set_threshold(*thresholds)
    if status == 0:
        print(f"{out}/index.html")
    return status


if __name__ == "__main__":
    sys.exit(main())
