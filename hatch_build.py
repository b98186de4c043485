"""Makes the page of the package from README.md, and wheels for Linux that hold liblsl.

The links of README.md lead nowhere outside of the repository. The variable ``REPOSITORY_URL``
names it, as for the site of the documents. Without it the page has the words of the links, and no
pictures: better than links to nowhere.

The variable ``BIOSENSOR_GATEWAY_LIBLSL`` names a folder that ``python -m installer.liblsl`` has
made, called after a processor; the wheel is then for that one.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
_PLACEHOLDER = "REPOSITORY_URL"
_LIBLSL, _LIBRARY = "BIOSENSOR_GATEWAY_LIBLSL", "biosensor_liblsl"


class CustomBuildHook(BuildHookInterface[Any]):
    """Puts liblsl into a wheel for one processor."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Say what is in the wheel and what it is for; nothing for an editable one."""
        named = os.environ.get(_LIBLSL, "")
        if not named or version != "standard":
            return
        folder = Path(named)
        build_data["pure_python"] = False
        # As old a glibc as the library needs.
        build_data["tag"] = f"py3-none-manylinux_2_26_{folder.name}"
        build_data["force_include"][str(folder / _LIBRARY)] = _LIBRARY


class CustomMetadataHook(MetadataHookInterface):
    """Adds what `pyproject.toml` calls dynamic."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add the page, and where the repository is."""
        repository = os.environ.get(_PLACEHOLDER, "").rstrip("/")
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": page(text, repository, metadata["version"]),
        }
        metadata["urls"] = _addresses(repository) if repository else {}


def page(text: str, repository: str, version: str) -> str:
    """Return README.md as it is to be read without the repository.

    Parameters
    ----------
    text
        Its text.
    repository
        Address of the repository; empty if nobody knows it.
    version
        Of the release, whose tag the links go by.
    """

    def absolute(found: re.Match[str]) -> str:
        is_picture, words, target = found.groups()
        if re.match(r"[a-z]+:", target):
            return found[0]
        if not repository:
            return "" if is_picture else words
        place, _, anchor = target.partition("#")
        way = "raw" if is_picture else "blob"
        address = f"{repository}/{way}/v{version}/{place or 'README.md'}"
        if is_picture and place.endswith(".svg"):
            # Else it is sent as a text, which no browser shows as a picture.
            address += "?sanitize=true"
        return f"{is_picture}[{words}]({address}{f'#{anchor}' if anchor else ''})"

    return _LINK.sub(absolute, text).replace(_PLACEHOLDER, repository or _PLACEHOLDER)


def _addresses(repository: str) -> dict[str, str]:
    return {
        "Repository": repository,
        "Documentation": f"{repository}/tree/main/docs",
        "Changelog": f"{repository}/blob/main/CHANGELOG.md",
        "Issues": f"{repository}/issues",
    }
