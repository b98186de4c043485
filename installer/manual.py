"""``python -m installer.manual FOLDER``: the documents as pages that any browser shows.

Links lead from page to page; a link to anything but a page of the installation becomes text. The
site (``make docs-site``) finds broken links of the documents, not this module.
"""

from __future__ import annotations

import html
import posixpath
import re
import shutil
import sys
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlsplit

from markdown_it import MarkdownIt
from markdown_it.token import Token

from installer.layout import ROOT

START = "index.html"
_ROOT_PAGES = {
    "README.md": START,
    "CONTRIBUTING.md": "contributing.html",
    "CHANGELOG.md": "changelog.html",
}
_PICTURES = ".svg"
_NOT_IN_A_SLUG = re.compile(r"[^\w\- ]")
_STYLE = """
body { font: 16px/1.5 'Segoe UI', sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }
table { border-collapse: collapse; display: block; overflow-x: auto }
th, td { border: 1px solid #ccc; padding: .3em .7em; text-align: left; vertical-align: top }
pre { background: #f4f6f6; padding: .8em; overflow-x: auto }
code { font-family: Consolas, monospace; font-size: .95em }
img { max-width: 100% }
a { color: #00796b }
"""


def main() -> None:
    """Write the pages."""
    write(Path(sys.argv[1]))


def write(folder: Path) -> None:
    """Write all pages and pictures into a folder.

    Raises
    ------
    OSError
        A document cannot be read, or a page not written.
    """
    pages = _pages()
    for document, page in pages.items():
        target = folder / page
        target.parent.mkdir(parents=True, exist_ok=True)
        text = (ROOT / document).read_text(encoding="utf-8")
        target.write_text(_page(text, document, pages), encoding="utf-8")
    for picture in sorted((ROOT / "docs" / "pictures").glob(f"*{_PICTURES}")):
        target = folder / "pictures" / picture.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(picture, target)


def _pages() -> dict[str, str]:
    """Map each document, by its path in the repository, to its page."""
    below = sorted(path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md"))
    found = {f"docs/{path.as_posix()}": path.with_suffix(".html").as_posix() for path in below}
    return {**_ROOT_PAGES, **found}


def _page(text: str, document: str, pages: dict[str, str]) -> str:
    parser = MarkdownIt("commonmark").enable("table")
    tokens = parser.parse(text)
    title = document
    for token, inline in pairwise(tokens):
        if token.type == "heading_open":
            plain = "".join(each.content for each in inline.children or ())
            token.attrSet("id", _slug(plain))
            title = plain if token.tag == "h1" else title
    for token in tokens:
        token.children = token.children and _relinked(token.children, document, pages)
    body = parser.renderer.render(tokens, parser.options, {})
    up = posixpath.relpath(START, posixpath.dirname(pages[document]) or ".")
    home = "" if pages[document] == START else f'<p><a href="{up}">Contents</a></p>\n'
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n{home}{body}</body>\n</html>\n"
    )


def _slug(heading: str) -> str:
    """Name a heading as GitHub does, and as the documents' links have it."""
    return _NOT_IN_A_SLUG.sub("", heading.lower()).replace(" ", "-")


def _relinked(tokens: list[Token], document: str, pages: dict[str, str]) -> list[Token]:
    """Lead links and pictures to the pages; drop the links that lead to none."""
    kept: list[Token] = []
    is_open: list[bool] = []
    for token in tokens:
        if token.type == "image":
            token.attrSet("src", _target(str(token.attrGet("src")), document, pages) or "")
        if token.type == "link_open":
            target = _target(str(token.attrGet("href")), document, pages)
            is_open.append(target is not None)
            token.attrSet("href", target or "")
        keeps = is_open[-1] if token.type in {"link_open", "link_close"} else True
        if token.type == "link_close":
            is_open.pop()
        if keeps:
            kept.append(token)
    return kept


def _target(link: str, document: str, pages: dict[str, str]) -> str | None:
    """Return where a link leads from a document's page; None if there is no such page."""
    parts = urlsplit(link)
    if parts.scheme or not parts.path:
        return link
    path = posixpath.normpath(posixpath.join(posixpath.dirname(document), parts.path))
    page = path.removeprefix("docs/") if path.endswith(_PICTURES) else pages.get(path)
    if page is None:
        return None
    there = posixpath.relpath(page, posixpath.dirname(pages[document]) or ".")
    return there + (f"#{parts.fragment}" if parts.fragment else "")


if __name__ == "__main__":
    main()
