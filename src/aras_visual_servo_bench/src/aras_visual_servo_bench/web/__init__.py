"""Web pages: the live page, the results browser and the report, and their shared parts.

Only commands and nodes that serve or write a page import this package.
"""

from pathlib import Path

SHARED = Path(__file__).parent / "page"  # scripts and style that several pages share
