"""Which licences may be shipped, and where their texts are from."""

from __future__ import annotations

import re
import sysconfig
import tomllib
from pathlib import Path

import pytest

from installer.bundle import known
from installer.bundle.distributions import Distribution, read_distributions
from installer.bundle.errors import (
    ForbiddenLicenceError,
    MissingTextError,
    UnknownLicenceError,
)
from installer.bundle.expressions import choice, declared, may_ship, normalise
from installer.bundle.licences import component_texts, distribution_texts
from installer.bundle.names import normalised
from installer.bundle.texts import FOLDER
from tests.installer.test_bundle_rig import Rig

ROOT = Path(__file__).parents[2]


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def installed(rig: Rig, *metadata: str, texts: dict[str, bytes] | None = None) -> Distribution:
    rig.install("subject", "1", {"subject.py": b""}, metadata, texts)
    return next(each for each in read_distributions((rig.packages,)) if each.name == "subject")


def bring(rig: Rig, licence: str, name: str = "subject") -> None:
    """Put a distribution with a text of its licence into the bundle."""
    rig.install(name, "1", {f"{name}.py": b""}, [f"License-Expression: {licence}"])
    rig.modules.append(name)


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        (["License-Expression: mit or apache-2.0"], "MIT OR Apache-2.0"),
        (["License: MIT"], "MIT"),
        (["License: Apache 2.0"], "Apache-2.0"),
        (["License: see file", "Classifier: License :: OSI Approved :: MIT License"], "MIT"),
        (["Classifier: License :: OSI Approved :: ISC License (ISCL)"], "ISC"),
    ],
)
def test_metadata_is_read_as_spdx(rig: Rig, metadata: list[str], expected: str) -> None:
    assert declared(installed(rig, *metadata)) == expected


def test_every_dependency_may_be_shipped() -> None:
    # Those that are for Windows only are not installed here; the build looks at them.
    lock = (ROOT / "requirements" / "gateway.txt").read_text(encoding="utf-8")
    wanted = {normalised(name) for name in re.findall(r"^([\w.-]+)==", lock, re.MULTILINE)}
    here = read_distributions((Path(sysconfig.get_path("purelib")),))
    # Bumble names them for radios that it drives itself; the installer leaves them out.
    ours = [each for each in here if each.name in wanted - {"libusb-package", "libusb1"}]
    assert len(ours) > len(wanted) / 2
    for each in ours:
        licence = normalise(known.LICENCES.get(each.name) or declared(each))
        assert may_ship(licence), each.name


@pytest.mark.parametrize(
    "metadata",
    [
        [],
        ["License: BSD"],
        ["Classifier: License :: OSI Approved :: BSD License"],
        # Both, or a choice? The classifiers do not say.
        [
            "Classifier: License :: OSI Approved :: MIT License",
            "Classifier: License :: OSI Approved :: GNU General Public License v2 (GPLv2)",
        ],
    ],
)
def test_metadata_that_is_not_clear_is_refused(rig: Rig, metadata: list[str]) -> None:
    with pytest.raises(UnknownLicenceError, match=r"subject-1\.dist-info does not say clearly"):
        declared(installed(rig, *metadata))


@pytest.mark.parametrize("expression", ["My own licence", "MIT AND", "", "Nonsense-1.0"])
def test_what_is_no_expression_is_refused(expression: str) -> None:
    with pytest.raises(UnknownLicenceError, match="no SPDX licence expression"):
        normalise(expression)


@pytest.mark.parametrize(
    ("expression", "allowed"),
    [
        ("MIT", True),
        ("MPL-2.0", True),
        ("GPL-2.0-only", False),
        ("LGPL-2.1-or-later", False),
        ("AGPL-3.0-or-later", False),
        ("MIT OR GPL-2.0-only", True),
        ("MIT AND LGPL-2.1-only", False),
        ("(MIT OR LGPL-2.1-only) AND (GPL-2.0-only OR Apache-2.0)", True),
        ("GPL-2.0-or-later WITH Bootloader-exception AND Apache-2.0", True),
        ("GPL-3.0-or-later WITH GCC-exception-3.1", True),
        ("GPL-2.0-only WITH Classpath-exception-2.0", False),
        ("Apache-2.0 WITH LLVM-exception", True),
    ],
)
def test_copyleft_is_refused_unless_there_is_a_choice(expression: str, *, allowed: bool) -> None:
    assert may_ship(expression) is allowed


@pytest.mark.parametrize("licence", ["LGPL-2.1-or-later", "GPL-3.0-only", "AGPL-3.0-only"])
def test_a_bundle_with_a_copyleft_component_is_refused(rig: Rig, licence: str) -> None:
    bring(rig, licence)
    with pytest.raises(ForbiddenLicenceError, match=rf"subject \({licence}\)"):
        rig.complete()
    assert not rig.out.exists()


def test_libusb_is_refused_whatever_the_wheel_says(rig: Rig) -> None:
    files = {"libusb_package/libusb-1.0.dll": b"MZ libusb"}
    rig.install("libusb-package", "1.0", files, ["License-Expression: Apache-2.0"])
    rig.put("_internal/libusb-1.0.dll", b"MZ libusb")
    with pytest.raises(ForbiddenLicenceError, match=r"libusb \(LGPL-2\.1-or-later\)"):
        rig.complete()


def test_all_copyleft_components_are_named(rig: Rig) -> None:
    bring(rig, "GPL-2.0-only", "first")
    bring(rig, "LGPL-3.0-only", "second")
    with pytest.raises(ForbiddenLicenceError, match=r"first \(GPL.*, second \(LGPL"):
        rig.complete()


def test_all_texts_of_a_wheel_are_taken(rig: Rig) -> None:
    texts = {
        "licenses/LICENSE": b"one",
        "licenses/src/vendored/COPYING": b"two",
        "NOTICE.txt": b"three",
        "entry_points.txt": b"no text of a licence",
    }
    found = distribution_texts(installed(rig, "License-Expression: MIT", texts=texts), "MIT")
    assert {text.path: text.content for text in found} == {
        "subject/LICENSE": b"one",
        "subject/src/vendored/COPYING": b"two",
        "subject/NOTICE.txt": b"three",
    }


@pytest.mark.parametrize("texts", [{}, {"licenses/LICENSE": b" \n"}])
def test_a_missing_text_is_an_error(rig: Rig, texts: dict[str, bytes]) -> None:
    distribution = installed(rig, "License-Expression: MIT", texts=texts)
    with pytest.raises(MissingTextError, match=r"no licence text for subject \(MIT\)"):
        distribution_texts(distribution, "MIT")


def test_a_kept_text_stands_in_for_a_missing_one(rig: Rig) -> None:
    rig.install("pySerial", "3.5", {"serial.py": b""}, ["License: BSD"], {})
    distribution = read_distributions((rig.packages,))[0]
    (text,) = distribution_texts(distribution, "BSD-3-Clause")
    assert text.path == "common/pyserial.txt"
    assert b"Chris Liechti" in text.content


def test_a_text_without_a_notice_serves_all_under_its_licence() -> None:
    found = component_texts("some-crate", "(MIT OR Apache-2.0) AND Unicode-3.0")
    assert [text.path for text in found] == ["common/Apache-2.0.txt", "common/Unicode-3.0.txt"]


def test_a_choice_needs_every_licence_of_a_conjunction() -> None:
    available = frozenset({"Apache-2.0"})
    assert choice("MIT OR Apache-2.0", available) == ("Apache-2.0",)
    assert choice("MIT AND Apache-2.0", available) is None
    assert choice("Apache-2.0 WITH LLVM-exception", available) is None


def test_the_source_of_each_kept_text_is_named() -> None:
    sources = tomllib.loads((FOLDER / "sources.toml").read_text(encoding="utf-8"))
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(sources)
    for name, entry in sources.items():
        assert entry["source"], name
        if entry.get("generic"):
            assert normalise(name) == name
