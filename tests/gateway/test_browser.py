"""Where browsers are that can show a page in a window of its own."""

from __future__ import annotations

from pathlib import Path

from biosensor_gateway.system.browser import apps


def test_browsers_of_a_mac_are_found_in_its_folders_of_applications(tmp_path: Path) -> None:
    everybody, own = tmp_path / "Applications", tmp_path / "me" / "Applications"
    edge = everybody / "Microsoft Edge.app" / "Contents" / "MacOS" / "Microsoft Edge"
    chrome = own / "Google Chrome.app" / "Contents" / "MacOS" / "Google Chrome"
    for program in (edge, chrome):
        program.parent.mkdir(parents=True)
        program.touch()
    # What is left of a removed one is none.
    (everybody / "Chromium.app" / "Contents").mkdir(parents=True)
    assert list(apps((everybody, own))) == [str(chrome), str(edge)]
