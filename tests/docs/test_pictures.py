"""Pictures are drawn from what was printed or measured, and ask nobody for anything."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.docs import fault_picture
from tests.docs.demo_picture import COLUMNS, drawn, printed, shown

PICTURES = sorted((Path(__file__).parents[2] / "docs" / "pictures").glob("*.svg"))
SVG = "{http://www.w3.org/2000/svg}"
PRINTED = f"""\
something that was logged
topic in /biosensors/       type     Hz
empatica_e4/tag             Empty    0.00
gateway/events              String   0.20
polar_h10/bat               Float32  0.00
polar_h10/ecg               Float32  130.14
polar_h10/ecg_chunk         Float32[]  1.02
zephyr/br                   Float32  1.00
zephyr/breathing            Float32  17.86
zephyr/hr                   UInt8    {"1.00".ljust(COLUMNS)} end
zephyr/ibi                  Float32  1.00
/biosensors/empatica_e4/tag: not expected, nobody presses the button
"""


def test_the_demo_is_shown_without_what_is_beside_it() -> None:
    heading, ecg, *breathing, heart_rate, more, reason = shown(PRINTED)
    assert heading.startswith("topic ")
    assert ecg.startswith("polar_h10/ecg ")
    assert len(breathing) == 2
    assert heart_rate.startswith("zephyr/hr ")
    assert "5 more topics" in more
    assert reason.endswith("nobody presses the button")


@pytest.mark.nightly
def test_a_program_prints_into_a_terminal_of_the_pictures_width() -> None:
    code = "import os, sys; print(sys.stdout.isatty(), os.get_terminal_size().columns)"
    assert printed([sys.executable, "-c", code]).split() == ["True", str(COLUMNS)]


@pytest.mark.nightly
def test_a_program_that_fails_is_not_drawn() -> None:
    with pytest.raises(subprocess.CalledProcessError):
        printed([sys.executable, "-c", "raise SystemExit(1)"])


def test_a_demo_that_failed_is_not_drawn() -> None:
    with pytest.raises(ValueError, match="no table"):
        shown("nothing received within 30 s\n")


def test_what_is_wider_than_the_terminal_is_cut_and_shows_it() -> None:
    texts = [element.text or "" for element in _texts(drawn(shown(PRINTED), "demo"))]
    assert any("130.14" in text for text in texts)
    assert not any("end" in text for text in texts)
    assert any("…" in text for text in texts)


def test_the_picture_of_faults_has_every_cell_of_its_table() -> None:
    texts = {element.text for element in _texts(fault_picture.picture())}
    headings, *sensors = fault_picture.rows()
    assert len(sensors) >= 7
    assert {*headings[1:], *(cell or "-" for row in sensors for cell in row)} <= texts


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.name)
def test_a_picture_is_whole_and_asks_nobody(picture: Path) -> None:
    text = picture.read_text(encoding="utf-8")
    assert ElementTree.fromstring(text).tag == f"{SVG}svg"
    assert "http" not in text.replace("http://www.w3.org/", "")
    assert "@import" not in text


def _texts(svg: str) -> list[ElementTree.Element]:
    return list(ElementTree.fromstring(svg).iter(f"{SVG}text"))
