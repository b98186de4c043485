"""A layout of PlotJuggler 3, as its own loader walks through it.

Its names of series: ``<topic>/data``, ``<topic>/data[0]``; the topic alone for a
message without fields. config/layouts/README.md says where that is from.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, parse

from tests.ros_packages.series import LAYOUTS, Series, read_series

PATH: Path = LAYOUTS / "plotjuggler.xml"


def root() -> Element:
    return parse(PATH).getroot()


def tabs() -> list[Element]:
    return root().findall("tabbed_widget/Tab")


def plots(element: Element) -> Iterator[Element]:
    return element.iter("plot")


def series_of(plot: Element) -> list[Series]:
    return [_read(curve.attrib["name"]) for curve in plot.findall("curve")]


def _read(name: str) -> Series:
    topic, separator, last = name.rpartition("/")
    if separator and last.startswith("data"):
        return read_series(topic, last)
    return read_series(name, "")
