"""Hooks of MkDocs: files at the root become pages, and links lead where their files went.

The documents are written for a reader of the repository, whose links lead from file to
file. On the site, README.md is the start page, and what is no page is found in the
repository, if its address is known (``extra.repository``).
"""

from __future__ import annotations

import os.path
import posixpath
import re
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
ROOT_PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Documents at the root of the repository, and their places on the site."""

_DOCS = "docs/"
_BRANCH = "main"
_DECISIONS, _BEHIND = "decisions/", 0.3
# Code comes first, because what looks like a link in it is none.
_CODE_OR_LINK = re.compile(
    r"(?P<code>^(?P<fence> *`{3,}).*?^ *`{3,}$|(?P<ticks>`+).+?(?P=ticks))"
    r"|(?P<image>!?)\[(?P<text>(?:[^\[\]]|\[[^\]]*\])*)\]\((?P<target>[^)\s]+)\)",
    re.DOTALL | re.MULTILINE,
)
_OTHER_HOST = r"""["']?(?:https?:)?//[^>]*>"""
_EXTERNAL_RESOURCE = re.compile(
    rf"<(?:script|img|iframe|source)\b[^>]*\bsrc={_OTHER_HOST}"
    rf"|<link\b(?=[^>]*\brel=[\"']?(?:stylesheet|pre))[^>]*\bhref={_OTHER_HOST}"
)

_log = get_plugin_logger("documents")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Link to the repository at the foot of each page, if its address is known."""
    extra = _extra(config)
    if extra["repository"]:
        link = {"icon": "fontawesome/brands/git-alt", "link": extra["repository"]}
        extra["social"] = [{**link, "name": "The repository"}]
    return config


def _extra(config: MkDocsConfig) -> dict[str, Any]:
    # MkDocs does not say of which types its own dictionary is.
    return cast("dict[str, Any]", config.extra)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the documents at the root."""
    for document, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / document)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead every link where its file went; of a bad one warn, which strict mode makes fatal."""
    text, problems = relinked(markdown, page.file.src_uri, _extra(config)["repository"])
    for problem in problems:
        _log.warning("%s: %s", page.file.src_uri, problem)
    if page.file.src_uri.startswith(_DECISIONS):
        # Whoever looks for "delete recording" wants to do it, and not to know why it is so.
        page.meta["search"] = {"boost": _BEHIND}
    return text


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Warn of whatever a browser would fetch from another host."""
    for resource in fetched(output):
        _log.warning("%s: fetched from another host: %s", page.file.src_uri, resource)
    return output


def fetched(html: str) -> list[str]:
    """Return the tags for which a browser asks another host; links to follow are none."""
    return _EXTERNAL_RESOURCE.findall(html)


def relinked(markdown: str, page: str, repository: str) -> tuple[str, list[str]]:
    """Return a page's text with links for the site, and what is wrong with them.

    Parameters
    ----------
    markdown
        Text with links relative to the file in the repository.
    page
        Path of the page below the site's root.
    repository
        Address of the repository; without one, a link to what is no page loses its target.
    """
    problems: list[str] = []

    def replaced(match: re.Match[str]) -> str:
        if match["code"] is not None:
            return match[0]
        target = match["target"]
        problem = _fault(target, page)
        if problem:
            problems.append(problem)
            return match[0]
        text = match["text"]
        if not match["image"]:
            # The text of a link can hold a picture.
            text, inner = relinked(text, page, repository)
            problems.extend(inner)
        new = _new_target(target, page, repository)
        return f"{match['image']}[{text}]({new})" if new else text

    return _CODE_OR_LINK.sub(replaced, markdown), problems


def _source(page: str) -> str:
    """Return the path in the repository from which a page is made."""
    sources = {page: document for document, page in ROOT_PAGES.items()}
    return sources.get(page, _DOCS + page)


def _path(target: str, page: str) -> str:
    """Return to which path in the repository a relative link leads."""
    path = target.partition("#")[0]
    source = _source(page)
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), path)) if path else source


def _is_external(target: str) -> bool:
    return bool(urlsplit(target).scheme) or target.startswith("//")


def _fault(target: str, page: str) -> str:
    """Say what is wrong with a link; empty if nothing is. No address is ever fetched."""
    if _is_external(target):
        address = urlsplit(target)
        is_complete = address.scheme in {"https", "http"} and "." in address.netloc
        return "" if is_complete else f"{target} is no complete address"
    path = _path(target, page)
    # Not even a file that happens to lie beside this checkout.
    if path.startswith("..") or not os.path.exists(ROOT / path):  # noqa: PTH110 - not every path is one
        return f"{target} leads to {path}, which does not exist"
    return ""


def _new_target(target: str, page: str, repository: str) -> str:
    """Return a link's target on the site, empty if there is none."""
    if _is_external(target) or target.startswith("#"):
        return target
    path, anchor = _path(target, page), target.partition("#")[1:]
    if path in ROOT_PAGES or path.startswith(_DOCS):
        if (ROOT / path).is_dir():
            path = f"{path}/README.md"
        place = ROOT_PAGES.get(path, path.removeprefix(_DOCS))
        return posixpath.relpath(place, posixpath.dirname(page) or ".") + "".join(anchor)
    address = f"{repository.rstrip('/')}/blob/{_BRANCH}/{path}" + "".join(anchor)
    return address if repository else ""
