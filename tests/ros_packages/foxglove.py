"""A layout of Foxglove in the form that the app imports and exports."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from tests.ros_packages.series import LAYOUTS, Series, read_series

PATH = LAYOUTS / "foxglove.json"
TABS = "Tab!sensors"


def document() -> dict[str, Any]:
    return json.loads(PATH.read_text())


def panels() -> dict[str, dict[str, Any]]:
    return document()["configById"]


def tabs() -> list[dict[str, Any]]:
    return panels()[TABS]["tabs"]


def leaves(node: Any) -> Iterator[str]:
    """Panel ids in a mosaic, which is a binary tree of splits."""
    if isinstance(node, str):
        yield node
    else:
        yield from leaves(node["first"])
        yield from leaves(node["second"])


def series_of(panel: dict[str, Any]) -> list[Series]:
    if "topicPath" in panel:
        return [_read(panel["topicPath"])]
    return [_read(path["value"]) for path in panel.get("paths", [])]


def _read(path: str) -> Series:
    # A ROS name has no dot, so that the first one begins the field.
    topic, _, field = path.partition(".")
    return read_series(topic, field)
