"""The manifest for winget, and the pictures and labels of the installer's windows."""

from __future__ import annotations

import hashlib
import re
import struct
from pathlib import Path
from typing import Any, cast

import pytest
from ruamel.yaml import YAML

from installer import pictures, winget
from installer.layout import PROGRAM, PUBLISHER, SOURCES, version

NSIS = (SOURCES / "biosensor-gateway.nsi").read_text(encoding="utf-8")
URL = "https://example.org/releases/download/v1/setup.exe"
# What fits into the list of choices at its usual size, with the box in front of it.
LONGEST_TEXT = 100
LONGEST_LABEL = 40


@pytest.fixture
def manifest(tmp_path: Path) -> dict[str, dict[str, Any]]:
    setup = tmp_path / "setup.exe"
    setup.write_bytes(b"MZ")
    winget.write(setup, URL, tmp_path / "out")
    loader = YAML(typ="safe", pure=True)
    found: dict[str, dict[str, Any]] = {}
    for path in (tmp_path / "out").iterdir():
        text = path.read_text(encoding="utf-8")
        content = cast("dict[str, Any]", loader.load(text))  # pyright: ignore[reportUnknownMemberType]
        kind = content["ManifestType"]
        assert text.startswith(
            f"# yaml-language-server: $schema=https://aka.ms/winget-manifest.{kind}.1.6.0."
        )
        found[path.name] = content
    return found


def test_the_manifest_is_of_this_installer(manifest: dict[str, dict[str, Any]]) -> None:
    name = winget.IDENTIFIER
    assert set(manifest) == {
        *(f"{name}.yaml", f"{name}.installer.yaml", f"{name}.locale.en-US.yaml"),
    }
    for content in manifest.values():
        assert content["PackageIdentifier"] == name
        assert content["PackageVersion"] == version()
        assert content["ManifestVersion"] == "1.6.0"
    installer = manifest[f"{name}.installer.yaml"]
    assert (installer["InstallerType"], installer["Scope"]) == ("nullsoft", "machine")
    assert installer["Commands"] == [PROGRAM]
    (file,) = installer["Installers"]
    assert file["InstallerUrl"] == URL
    assert file["InstallerSha256"] == hashlib.sha256(b"MZ").hexdigest().upper()
    assert manifest[f"{name}.locale.en-US.yaml"]["Publisher"] == PUBLISHER


def test_the_manifest_knows_the_exit_codes_of_the_installer(
    manifest: dict[str, dict[str, Any]],
) -> None:
    (file,) = manifest[f"{winget.IDENTIFIER}.installer.yaml"]["Installers"]
    codes = {each["InstallerReturnCode"] for each in file["ExpectedReturnCodes"]}
    (told,) = re.findall(r"; Exit codes: ((?:.*\n; ?)*.*)\.\n", NSIS)
    assert {str(each) for each in codes} <= set(re.findall(r"\d", told))
    assert f"SetErrorLevel {winget.RUNS}" in NSIS


def test_the_installer_has_pictures_of_its_own(tmp_path: Path) -> None:
    pictures.draw(tmp_path)
    used = re.findall(r'"\$\{PICTURES\}/([\w.]+)"', NSIS)
    assert set(used) == {each.name for each in tmp_path.iterdir()}
    for name, size in (
        (pictures.WELCOME, pictures.WELCOME_SIZE),
        (pictures.HEADER, pictures.HEADER_SIZE),
    ):
        content = (tmp_path / name).read_bytes()
        assert content[:2] == b"BM"
        assert struct.unpack_from("<ii", content, 18) == size
        assert struct.unpack_from("<I", content, 2) == (len(content),)
    icon = (tmp_path / pictures.ICON).read_bytes()
    assert struct.unpack_from("<HHH", icon) == (0, 1, len(pictures.ICON_SIZES))
    for index, size in enumerate(pictures.ICON_SIZES):
        width, *_, length, at = struct.unpack_from("<BBBBHHII", icon, 6 + 16 * index)
        assert width == size % 256
        assert at + length <= len(icon)
    assert icon[at : at + 4] == b"\x89PNG"  # pyright: ignore[reportPossiblyUnboundVariable]


def test_windows_does_not_blur_the_installer_and_no_label_is_cut_off() -> None:
    assert re.search(r"^ManifestDPIAware true$", NSIS, re.MULTILINE)
    assert re.search(r"^!define MUI_COMPONENTSPAGE_SMALLDESC$", NSIS, re.MULTILINE)
    labels = re.findall(r'^Section (?:/o )?"(?:un\.)?(\w[^"$]*)"', NSIS, re.MULTILINE)
    assert len(labels) == 3
    assert [each for each in labels if len(each) > LONGEST_LABEL] == []


def test_every_choice_is_explained() -> None:
    sections = re.findall(r'^Section .*" (Section\w+)$', NSIS, re.MULTILINE)
    explained = re.findall(r"MUI_DESCRIPTION_TEXT \$\{(\w+)\} \$\((\w+)\)", NSIS)
    assert sorted(sections) == sorted(section for section, _ in explained)
    texts = dict(re.findall(r'^LangString (\w+) \S+ "((?:[^"\\]|\\\n *)*)"$', NSIS, re.M))
    assert {text for _, text in explained} == texts.keys()
    # There is room for two lines; a longer text is cut off.
    shown = {name: re.sub(r"\\\n *", "", text) for name, text in texts.items()}
    assert {name: len(each) for name, each in shown.items() if len(each) > LONGEST_TEXT} == {}
