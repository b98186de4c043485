"""The site and its pictures are built from what is there, and their links lead somewhere."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config  # pyright: ignore[reportUnknownVariableType]
from mkdocs.exceptions import Abort
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from tests.docs import fault_picture
from tests.docs.site_hooks import ROOT, fetched, on_page_markdown, relinked

# The site is built strictly, and its links lead where the files went.

REPOSITORY = "https://example.org/lab/gateway"


@pytest.mark.parametrize(
    ("page", "link", "on_site"),
    [
        ("index.md", "docs/lab-pc.md#run", "lab-pc.md#run"),
        ("index.md", "CONTRIBUTING.md", "contributing.md"),
        ("index.md", "LICENSE", f"{REPOSITORY}/blob/main/LICENSE"),
        ("index.md", "docs/pictures/icon.svg", "pictures/icon.svg"),
        ("sensors/zephyr.md", "../../CONTRIBUTING.md#style", "../contributing.md#style"),
        ("sensors/zephyr.md", "README.md", "README.md"),
        ("contributing.md", "docs/decisions", "decisions/README.md"),
        ("contributing.md", "docs/../README.md", "index.md"),
        ("ros.md", "../ros_side/biosensor_msgs", f"{REPOSITORY}/blob/main/ros_side/biosensor_msgs"),
        ("ros.md", "#install", "#install"),
        ("ros.md", "https://example.org/a?b=c#d", "https://example.org/a?b=c#d"),
    ],
)
def test_a_link_leads_where_its_file_went(page: str, link: str, on_site: str) -> None:
    assert relinked(f"see [here]({link}), yes", page, REPOSITORY) == (
        f"see [here]({on_site}), yes",
        [],
    )


def test_a_link_to_a_source_file_is_text_where_the_repository_is_unknown() -> None:
    assert relinked("in [`msgs`](../ros_side/biosensor_msgs).", "ros.md", "") == ("in `msgs`.", [])


def test_a_picture_that_is_a_link_keeps_both() -> None:
    text = "[![icon](docs/pictures/icon.svg)](docs/lab-pc.md)"
    assert relinked(text, "index.md", "") == ("[![icon](pictures/icon.svg)](lab-pc.md)", [])


@pytest.mark.parametrize(
    "text", ["`[a](b.md)`", "```text\n[a](b.md)\n```", "   ```sh\n   [a](b.md)\n   ```"]
)
def test_code_is_left_alone(text: str) -> None:
    assert relinked(text, "index.md", "") == (text, [])


@pytest.mark.parametrize(
    "link", ["docs/none.md", "../other/README.md", "https:/example.org", "ftp://a.b/c"]
)
def test_a_link_that_leads_nowhere_is_named(link: str) -> None:
    _, problems = relinked(f"[here]({link})", "index.md", REPOSITORY)
    assert len(problems) == 1
    assert link in problems[0]


@pytest.mark.parametrize(
    ("page", "meta"), [("page.md", {}), ("decisions/node/a.md", {"search": {"boost": 0.3}})]
)
def test_decisions_are_found_behind_the_pages_for_users(
    page: str, meta: dict[str, object], tmp_path: Path
) -> None:
    config = load_config(config_file=str(ROOT / "mkdocs.yml"), site_dir=str(tmp_path))
    shown = Page(None, File(page, str(ROOT), str(tmp_path), use_directory_urls=False), config)
    on_page_markdown("delete recording", shown, config, Files([]))
    assert shown.meta == meta


@pytest.mark.parametrize(
    "html",
    [
        '<script src="https://example.org/a.js"></script>',
        '<img alt="" src="//example.org/a.svg">',
        '<link rel="stylesheet" href="https://example.org/a.css">',
        '<link href="https://example.org" rel="preconnect">',
    ],
)
def test_what_another_host_would_be_asked_for_is_found(html: str) -> None:
    assert len(fetched(f"<p>{html}</p>")) == 1


def test_what_this_site_has_and_what_a_reader_may_follow_are_none() -> None:
    own = '<script src="a.js"></script><link rel="stylesheet" href="../a.css"><img src="/a.svg">'
    other = (
        '<a href="https://example.org">there</a><link rel="canonical" href="https://example.org">'
    )
    assert not fetched(own + other)


@pytest.mark.parametrize(
    ("text", "is_good"),
    [("[b](#b)", True), ("[b](#c)", False), ("[b](none.md)", False), ("[b](/page.md)", False)],
)
def test_our_settings_refuse_a_link_that_leads_nowhere(
    text: str, is_good: bool, tmp_path: Path
) -> None:
    for folder, name, content in [
        ("docs", "page.md", f"# A\n\n{text}\n\n## B\n"),
        ("theme", "main.html", "{{ page.content }}"),
    ]:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(content, "utf-8")
    config = load_config(
        config_file=str(ROOT / "mkdocs.yml"),
        docs_dir=str(tmp_path / "docs"),
        site_dir=str(tmp_path / "site"),
        nav=["page.md"],
        # The real theme costs seconds and has no say in this.
        theme={"name": None, "custom_dir": str(tmp_path / "theme")},
        plugins=[],
        hooks=[],
    )
    if is_good:
        build(config)
    else:
        with pytest.raises(Abort):
            build(config)


# Pictures are drawn from what was printed or measured, and ask nobody for anything.
PICTURES = sorted((Path(__file__).parents[2] / "docs" / "pictures").glob("*.svg"))
SVG = "{http://www.w3.org/2000/svg}"


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
