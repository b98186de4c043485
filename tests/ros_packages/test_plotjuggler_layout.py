"""The layout has the form on which PlotJuggler's loader relies."""

from __future__ import annotations

import re
from xml.etree.ElementTree import Element

import pytest

from tests.ros_packages import plotjuggler
from tests.ros_packages.series import declared_topics, label

STREAMER = "ROS2 Topic Subscriber"
STYLES = {"Lines", "Dots", "LinesAndDots", "Sticks", "Steps", "StepsInv"}
OPTIONS = {
    "use_header_stamp",
    "discard_large_arrays",
    "max_array_size",
    "boolean_strings_to_number",
    "remove_suffix_from_strings",
    "selected_topics",
}


@pytest.fixture
def root() -> Element:
    return plotjuggler.root()


def _splitters(element: Element) -> list[Element]:
    return list(element.iter("DockSplitter"))


def test_the_main_window_has_titled_tabs(root: Element) -> None:
    (window,) = root.findall("tabbed_widget")
    # Under another name the loader finds no window to put it into.
    assert (window.get("name"), window.get("parent")) == ("Main Window", "main_window")
    titles = [tab.attrib["tab_name"] for tab in plotjuggler.tabs()]
    assert len(set(titles)) == len(titles)
    current = window.find("currentTabIndex")
    assert current is not None
    assert int(current.attrib["index"]) in range(len(titles))


def test_each_tab_has_one_container_with_one_splitter() -> None:
    for tab in plotjuggler.tabs():
        (container,) = tab.findall("Container")
        assert tab.get("containers") == "1"
        assert [child.tag for child in container] == ["DockSplitter"]


def test_each_splitter_has_as_many_parts_and_sizes_as_it_says(root: Element) -> None:
    for splitter in _splitters(root):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert int(splitter.attrib["count"]) == len(splitter) == len(sizes) > 0
        assert sum(sizes) == pytest.approx(1, abs=1e-3)
        assert min(sizes) > 0
        assert {child.tag for child in splitter} <= {"DockArea", "DockSplitter"}


def test_splitters_alternate(root: Element) -> None:
    for splitter in _splitters(root):
        orientations = {part.get("orientation") for part in splitter.findall("DockSplitter")}
        # The docking library merges parts that are split the same way into one.
        assert orientations <= {"-": {"|"}, "|": {"-"}}[splitter.attrib["orientation"]]


def test_each_area_is_a_titled_plot_over_time(root: Element) -> None:
    for area in root.iter("DockArea"):
        (plot,) = area
        assert plot.tag == "plot"
        assert area.get("name")
        assert plot.get("mode") == "TimeSeries"
        assert plot.get("style") in STYLES
        assert {child.tag for child in plot} <= {"range", "limitY", "curve"}
        for limit in plot.findall("limitY"):
            assert float(limit.get("min", "-inf")) < float(limit.get("max", "inf"))


def test_the_curves_of_a_plot_can_be_told_apart(root: Element) -> None:
    for plot in plotjuggler.plots(root):
        colours = [curve.attrib["color"] for curve in plot.findall("curve")]
        assert len(set(colours)) == len(colours) > 0
        assert all(re.fullmatch(r"#[0-9a-f]{6}", colour) for colour in colours)


def _letters(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


def test_the_title_names_the_channels_in_order(root: Element) -> None:
    # The legend only numbers them: data[0], data[1].
    for area in root.iter("DockArea"):
        channels = plotjuggler.series_of(area[0])
        if len(channels) == 1:
            continue
        rest = _letters(area.attrib["name"])
        for name in (label(series).rpartition("/")[-1] for series in channels):
            _, found, rest = rest.partition(_letters(name))
            assert found, f"{area.attrib['name']} does not name {name}, or not in its place"


def test_a_value_without_a_duration_is_drawn_as_a_dot(root: Element) -> None:
    for plot in plotjuggler.plots(root):
        (topic,) = {series.topic for series in plotjuggler.series_of(plot)}
        if declared_topics()[topic].stream.data_name in {"ibi", "tag"}:
            assert plot.get("style") == "Dots"


def test_it_starts_the_streamer_with_the_topics_that_it_shows(root: Element) -> None:
    started = root.find("previouslyLoaded_Streamer")
    assert started is not None
    # Only with it do the curves get placeholders, so that the loader keeps them.
    assert started.get("name") == STREAMER
    (plugin,) = root.findall("Plugins/plugin")
    assert plugin.get("ID") == STREAMER
    options = {option.tag: option.attrib["value"] for option in plugin}
    assert set(options) == OPTIONS
    selected = options["selected_topics"].split(";")
    shown = [
        series.topic for plot in plotjuggler.plots(root) for series in plotjuggler.series_of(plot)
    ]
    assert sorted(selected) == sorted(set(shown))


def test_it_cuts_off_no_array_that_it_shows(root: Element) -> None:
    longest = max(len(declared.stream.channels) for declared in declared_topics().values())
    limit = root.find("Plugins/plugin/max_array_size")
    assert limit is not None
    assert int(limit.attrib["value"]) >= longest
