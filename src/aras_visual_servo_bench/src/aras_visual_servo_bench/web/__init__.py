"""Pages for a browser: the live page, the results browser and the report, and what they share.

Only commands and nodes that start a page import it.
"""

from pathlib import Path

SHARED = Path(__file__).parent / "page"  # scripts and style of more than one page
