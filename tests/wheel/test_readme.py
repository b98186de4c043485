"""The page of the package: README.md, whose links must lead somewhere without the repository."""

from __future__ import annotations

import re

import pytest

from hatch_build import page
from tests.wheel.conftest import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
REPOSITORY = "https://example.org/lab/gateway"
TARGETS = re.compile(r"\]\(([^)\s]+)\)")


@pytest.mark.parametrize("repository", ["", REPOSITORY])
def test_no_link_needs_the_repository(repository: str) -> None:
    shown = page(README, repository, "1.2.3")
    targets = TARGETS.findall(shown)
    assert targets
    assert [each for each in targets if not each.startswith("https://")] == []


def test_links_lead_to_the_release_and_pictures_are_pictures() -> None:
    shown = page(README, REPOSITORY, "1.2.3")
    assert f"({REPOSITORY}/blob/v1.2.3/docs/try-it.md)" in shown
    assert f"({REPOSITORY}/blob/v1.2.3/README.md#limits)" in shown
    assert f"({REPOSITORY}/raw/v1.2.3/docs/pictures/page.png)" in shown
    assert f"({REPOSITORY}/raw/v1.2.3/docs/pictures/demo.svg?sanitize=true)" in shown
    assert f"git clone {REPOSITORY} biosensor-gateway" in shown
    for place in TARGETS.findall(shown):
        path = place.removeprefix(REPOSITORY).partition("v1.2.3/")[2]
        assert (ROOT / re.split(r"[#?]", path)[0]).exists(), place


def test_without_an_address_the_words_stay() -> None:
    text = "![A\npicture](a.png) and [two\nwords](docs/a.md#b), [LSL](https://example.org)\n"
    assert page(text, "", "1") == " and two\nwords, [LSL](https://example.org)\n"
