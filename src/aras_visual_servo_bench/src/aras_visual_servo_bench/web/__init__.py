"""Web pages: the live page, the results browser and the report; and the code that they share.

Only commands and nodes that serve or write a page import this package.
"""

from pathlib import Path

SHARED = Path(__file__).parent / "page"  # folder of the scripts and styles that several pages use
