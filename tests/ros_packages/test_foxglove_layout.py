"""The layout has the form that Foxglove imports."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.ros_packages import foxglove
from tests.ros_packages.series import Series, label

PANEL_TYPES = {"DiagnosticStatusPanel", "DiagnosticSummary", "Plot", "RawMessages", "Tab"}
SPLIT = {"direction", "first", "second", "splitPercentage"}


@pytest.fixture
def document() -> dict[str, Any]:
    return foxglove.document()


def _type(panel: str) -> str:
    return panel.partition("!")[0]


def _plots(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [panel for name, panel in document["configById"].items() if _type(name) == "Plot"]


def _splits(node: Any) -> list[dict[str, Any]]:
    if isinstance(node, str):
        return []
    return [node, *_splits(node["first"]), *_splits(node["second"])]


def test_it_has_the_parts_of_an_exported_layout(document: dict[str, Any]) -> None:
    expected = {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert set(document) == expected
    assert (document["globalVariables"], document["userNodes"]) == ({}, {})
    assert document["playbackConfig"]["speed"] == 1


def test_each_panel_has_a_type_that_the_app_knows(document: dict[str, Any]) -> None:
    assert {_type(panel) for panel in document["configById"]} == PANEL_TYPES
    assert all(re.fullmatch(r"\w+!\w+", panel) for panel in document["configById"])


def test_each_panel_is_in_one_place(document: dict[str, Any]) -> None:
    mosaics = [document["layout"], *(tab["layout"] for tab in foxglove.tabs())]
    placed = [panel for mosaic in mosaics for panel in foxglove.leaves(mosaic)]
    assert sorted(placed) == sorted(document["configById"])


def test_each_split_has_two_parts_and_a_share(document: dict[str, Any]) -> None:
    mosaics = [document["layout"], *(tab["layout"] for tab in foxglove.tabs())]
    splits = [split for mosaic in mosaics for split in _splits(mosaic)]
    assert all(set(split) == SPLIT for split in splits)
    assert {split["direction"] for split in splits} == {"row", "column"}
    assert all(0 < split["splitPercentage"] < 100 for split in splits)


def test_the_tabs_have_titles(document: dict[str, Any]) -> None:
    config = document["configById"][foxglove.TABS]
    titles = [tab["title"] for tab in config["tabs"]]
    assert len(set(titles)) == len(titles)
    assert config["activeTabIdx"] in range(len(titles))


def test_a_plot_is_over_the_time_of_arrival(document: dict[str, Any]) -> None:
    # The messages have no header.
    for plot in _plots(document):
        assert plot["xAxisVal"] == "timestamp"
        assert {path["timestampMethod"] for path in plot["paths"]} == {"receiveTime"}
        assert all(path["enabled"] for path in plot["paths"])
        assert plot.get("minYValue", float("-inf")) < plot.get("maxYValue", float("inf"))


def test_a_plot_has_a_title_and_the_channels_have_their_names(document: dict[str, Any]) -> None:
    for plot in _plots(document):
        assert plot["foxglovePanelTitle"]
        labels = [path["label"] for path in plot["paths"]]
        assert labels == [label(series) for series in foxglove.series_of(plot)]
        assert len({path["color"] for path in plot["paths"]}) == len(labels) > 0


def test_messages_without_a_number_are_shown_as_they_are(document: dict[str, Any]) -> None:
    panels = document["configById"].items()
    raw = [foxglove.series_of(panel) for name, panel in panels if _type(name) == "RawMessages"]
    assert raw == [[Series("/biosensors/empatica_e4/tag", None)]]


def test_the_diagnostics_are_beside_the_tabs(document: dict[str, Any]) -> None:
    beside = set(foxglove.leaves(document["layout"])) - {foxglove.TABS}
    assert {_type(panel) for panel in beside} == {"DiagnosticSummary", "DiagnosticStatusPanel"}
    topics = {document["configById"][panel]["topicToRender"] for panel in beside}
    assert topics == {"/diagnostics"}
