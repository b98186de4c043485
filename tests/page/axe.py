"""What axe-core finds on a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from playwright.sync_api import Page

_AXE = (Path(__file__).parent / "vendor" / "axe.min.js").read_text()


def violations(page: Page) -> list[dict[str, Any]]:
    """Return what stands in somebody's way, with the elements where it does."""
    page.evaluate(_AXE)
    found = page.evaluate("axe.run().then(result => result.violations)")
    return [{"id": each["id"], "nodes": [n["html"] for n in each["nodes"]]} for each in found]
