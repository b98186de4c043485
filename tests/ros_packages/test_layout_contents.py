"""What the layouts show is what the sensors are declared to emit."""

from __future__ import annotations

import itertools

import pytest

from tests.ros_packages import foxglove, plotjuggler
from tests.ros_packages.series import DIMENSIONLESS, SENSORS, Series, declared_topics, unit


def _plotjuggler() -> list[list[list[Series]]]:
    return [
        [plotjuggler.series_of(plot) for plot in plotjuggler.plots(tab)]
        for tab in plotjuggler.tabs()
    ]


def _foxglove() -> list[list[list[Series]]]:
    panels = foxglove.panels()
    return [
        [foxglove.series_of(panels[panel]) for panel in foxglove.leaves(tab["layout"])]
        for tab in foxglove.tabs()
    ]


# Tabs of plots of series.
LAYOUTS = {"plotjuggler": _plotjuggler, "foxglove": _foxglove}


@pytest.fixture(params=LAYOUTS)
def tabs(request: pytest.FixtureRequest) -> list[list[list[Series]]]:
    return LAYOUTS[request.param]()


def test_each_channel_of_each_sensor_is_shown_once(tabs: list[list[list[Series]]]) -> None:
    shown = list(itertools.chain.from_iterable(itertools.chain.from_iterable(tabs)))
    declared = declared_topics()
    assert {stream.sensor for stream in declared.values()} == set(SENSORS)
    expected = set[Series]().union(*(stream.series(topic) for topic, stream in declared.items()))
    assert set(shown) == expected
    assert len(shown) == len(expected)


def test_a_tab_is_about_one_sensor(tabs: list[list[list[Series]]]) -> None:
    for tab in tabs:
        topics = {series.topic for plot in tab for series in plot}
        assert len({declared_topics()[topic].sensor for topic in topics}) == 1


def test_a_plot_shows_one_stream_in_one_unit(tabs: list[list[list[Series]]]) -> None:
    for plot in itertools.chain.from_iterable(tabs):
        assert len({series.topic for series in plot}) == 1
        # Flags, grades and fractions share a scale.
        assert (
            len({None if unit(series) in DIMENSIONLESS else unit(series) for series in plot}) == 1
        )
