"""``python -m installer.winget SETUP URL FOLDER``: the manifest by which winget installs a release.

Format: Microsoft's "Create your package manifest", version 1.6.0. The three files of the
folder are what a pull request to microsoft/winget-pkgs consists of.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path

from installer.layout import PROGRAM, PUBLISHER, version

IDENTIFIER = "BiosensorGateway.BiosensorGateway"
NAME = "Biosensor Gateway"
_FORMAT = "1.6.0"
_LOCALE = "en-US"
RUNS = 3
"""Exit code of the installer while a session runs; see biosensor-gateway.nsi."""


def main() -> None:
    """Write the manifest."""
    setup, url, folder = sys.argv[1:]
    write(Path(setup), url, Path(folder))


def write(setup: Path, url: str, folder: Path) -> None:
    """Write the manifest of an installer.

    Parameters
    ----------
    setup
        The installer.
    url
        Where everybody can download it.
    folder
        Gets three files.

    Raises
    ------
    OSError
        The installer cannot be read, or the folder not written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256(setup.read_bytes()).hexdigest().upper()
    for kind, (ending, content) in _files(url, digest).items():
        head = {"PackageIdentifier": IDENTIFIER, "PackageVersion": version()}
        tail = {"ManifestType": kind, "ManifestVersion": _FORMAT}
        lines = [_line(key, value) for key, value in {**head, **content, **tail}.items()]
        text = "\n".join([_schema(kind), *lines, ""])
        (folder / f"{IDENTIFIER}{ending}.yaml").write_text(text, encoding="utf-8", newline="\n")


def _files(url: str, digest: str) -> Mapping[str, tuple[str, Mapping[str, object]]]:
    installer = {
        "Architecture": "x64",
        "InstallerUrl": url,
        "InstallerSha256": digest,
        "ExpectedReturnCodes": [
            {"InstallerReturnCode": 1, "ReturnResponse": "cancelledByUser"},
            {"InstallerReturnCode": RUNS, "ReturnResponse": "packageInUse"},
        ],
    }
    return {
        "version": ("", {"DefaultLocale": _LOCALE}),
        "installer": (
            ".installer",
            {
                "InstallerType": "nullsoft",
                "Scope": "machine",
                "MinimumOSVersion": "10.0.0.0",
                "UpgradeBehavior": "install",
                "Commands": [PROGRAM],
                "Installers": [installer],
            },
        ),
        "defaultLocale": (
            f".locale.{_LOCALE}",
            {
                "PackageLocale": _LOCALE,
                "Publisher": PUBLISHER,
                "PackageName": NAME,
                "License": "Apache-2.0",
                "ShortDescription": "Wearable biosensors as Lab Streaming Layer outlets",
                "Tags": ["biosensor", "lab-streaming-layer", "psychophysiology"],
            },
        ),
    }


def _line(key: str, value: object) -> str:
    # JSON is YAML, and quotes what YAML would take for something else.
    return f"{key}: {json.dumps(value)}"


def _schema(kind: str) -> str:
    place = f"https://aka.ms/winget-manifest.{kind}.{_FORMAT}.schema.json"
    return f"# yaml-language-server: $schema={place}"


if __name__ == "__main__":
    main()
