"""What a silent installation leaves on a PC; nothing here changes it."""

from __future__ import annotations

import json
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from uuid import UUID

import pytest

from installer.layout import PROGRAM, PUBLISHER, WINDOWED, version
from tests.rigs.windows.pc import NAME, UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.registry import (
    APP_PATH_KEY,
    BIN_FOLDER,
    DEFAULT_FOLDER,
    OWN_KEY,
    RUN_KEY,
    Registry,
    Value,
    path_entries,
    search_path,
    start_menu,
)

LINK = re.compile(r'(?:href|src)="([^"]+)"')
MEBIBYTE = 1024 * 1024
EXE = rf"{BIN_FOLDER}\{PROGRAM}.exe"
PAGE_EXE = rf"{BIN_FOLDER}\{WINDOWED}.exe"
UNINSTALLER = rf"{DEFAULT_FOLDER}\uninstall.exe"


@pytest.fixture(scope="module")
def registry(installed: WindowsPc) -> Registry:
    return Registry.of(installed.prefix.folder)


def size(folder: Path) -> int:
    return sum(each.stat().st_size for each in folder.rglob("*") if each.is_file())


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_folder_has_the_program_and_what_belongs_to_it(bundle: Path) -> None:
    assert {each.name for each in bundle.iterdir()} == {
        *("bin", "uninstall.exe", "docs", "licenses", "sbom.cdx.json"),
    }


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_folder_of_path_has_the_one_command(bundle: Path) -> None:
    """Else ``uninstall /S``, typed in any terminal, would remove the program."""
    programs = {f"{PROGRAM}.exe", f"{WINDOWED}.exe"}
    assert {each.name for each in (bundle / "bin").iterdir()} == {*programs, "_internal"}
    # Typed, a name with a space is another command, with an argument.
    assert " " in WINDOWED
    # What records is started by its full path.
    hidden = (bundle / "bin" / "_internal").rglob("*.exe")
    assert [each.name for each in hidden] == ["LabRecorderCLI.exe"]


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_words_of_the_products_name_are_no_command(installed: WindowsPc) -> None:
    ended = installed.prefix.attempt("cmd", "/c", *WINDOWED.split())
    assert ended.returncode != 0


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_program_without_a_console_costs_next_to_nothing(bundle: Path) -> None:
    content = (bundle / "bin" / f"{WINDOWED}.exe").read_bytes()
    assert len(content) <= 3 * MEBIBYTE
    (header,) = struct.unpack_from("<I", content, 0x3C)
    # The subsystem, in the optional header behind those of PE and COFF: 2 has no console.
    assert struct.unpack_from("<H", content, header + 4 + 20 + 68) == (2,)


@pytest.mark.system
@pytest.mark.timeout(900)
def test_uninstall_is_no_command(installed: WindowsPc) -> None:
    ended = installed.prefix.attempt("cmd", "/c", "uninstall", "/S")
    assert ended.returncode != 0
    installed.prefix.settle()
    assert installed.program.is_file()


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_documentation_comes_along_and_its_links_lead_somewhere(bundle: Path) -> None:
    docs = bundle / "docs"
    pages = list(docs.rglob("*.html"))
    assert {"index.html", "lab-pc.html", "polar_h10.html"} <= {each.name for each in pages}
    for page in pages:
        for link in LINK.findall(page.read_text("utf-8")):
            if not link.startswith(("http", "#")):
                assert (page.parent / link.partition("#")[0]).resolve().is_file(), (page, link)


@pytest.mark.system
@pytest.mark.timeout(900)
def test_licences_and_the_list_of_components_come_along(bundle: Path) -> None:
    assert any((bundle / "licenses").iterdir())
    assert json.loads((bundle / "sbom.cdx.json").read_text("utf-8"))["bomFormat"] == "CycloneDX"


@pytest.mark.system
@pytest.mark.timeout(900)
def test_it_is_small_enough(setup: Path, bundle: Path, record_property: object) -> None:
    assert callable(record_property)
    record_property("setup_bytes", setup.stat().st_size)
    record_property("installed_bytes", size(bundle))
    assert setup.stat().st_size <= 45 * MEBIBYTE
    assert size(bundle) <= 130 * MEBIBYTE


@pytest.mark.system
@pytest.mark.timeout(900)
def test_windows_lists_it_among_the_installed_programs(registry: Registry, bundle: Path) -> None:
    entry = dict(registry.key(UNINSTALL_KEY) or {})
    estimated = entry.pop("estimatedsize")
    assert estimated.kind == "REG_DWORD"
    assert int(estimated.data) == pytest.approx(size(bundle) / 1024, rel=0.02)
    assert {name: value.data for name, value in entry.items()} == {
        "displayname": NAME,
        "displayversion": version(),
        "displayicon": EXE,
        "publisher": PUBLISHER,
        "installlocation": DEFAULT_FOLDER,
        "uninstallstring": f'"{UNINSTALLER}"',
        "quietuninstallstring": f'"{UNINSTALLER}" /S _?={DEFAULT_FOLDER}',
        "nomodify": 1,
        "norepair": 1,
    }


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_run_dialog_finds_it(registry: Registry) -> None:
    assert registry.key(APP_PATH_KEY) == {
        "": Value("REG_SZ", EXE),
        "path": Value("REG_SZ", BIN_FOLDER),
    }


@pytest.mark.system
@pytest.mark.timeout(900)
def test_it_comes_last_in_path_and_all_else_stays(registry: Registry, pc: WindowsPc) -> None:
    before = search_path(Registry.of(pc.prefix.folder))
    assert "%SystemRoot%" in str(before.data)
    assert before.kind == "REG_EXPAND_SZ"
    assert search_path(registry) == Value("REG_EXPAND_SZ", f"{before.data};{BIN_FOLDER}")
    assert path_entries(registry).count(BIN_FOLDER) == 1


@pytest.mark.system
@pytest.mark.timeout(900)
def test_a_new_terminal_finds_the_command(installed: WindowsPc) -> None:
    ended = installed.prefix.attempt("cmd", "/c", PROGRAM, "--version")
    assert (ended.returncode, ended.stdout.strip()) == (0, f"{PROGRAM} {version()}")


@pytest.mark.system
@pytest.mark.timeout(900)
def test_all_users_have_its_entries_in_the_start_menu(installed: WindowsPc) -> None:
    cmd = r"C:\windows\system32\cmd.exe"
    found = {each.stem: read_shortcut(each) for each in start_menu(installed).iterdir()}
    home = "%USERPROFILE%"
    assert found == {
        NAME: Shortcut(PAGE_EXE, "", home, PAGE_EXE),
        "Run in a console": Shortcut(cmd, f'/k ""{EXE}" run"', home, EXE),
        "Check this PC": Shortcut(cmd, f'/k ""{EXE}" doctor"', home, EXE),
        "Settings": Shortcut(cmd, f'/c ""{EXE}" config edit || pause"', home, EXE),
        "Documentation": Shortcut(rf"{DEFAULT_FOLDER}\docs\index.html", "", home),
        "Uninstall": Shortcut(UNINSTALLER, "", home),
    }
    shortcuts = {name for name in installed.files() if name.endswith(".lnk")}
    assert len(shortcuts) == len(found)


@pytest.mark.system
@pytest.mark.timeout(900)
def test_nothing_else_is_done_without_being_asked(registry: Registry) -> None:
    assert registry.key(OWN_KEY) is None
    assert registry.value(RUN_KEY, NAME) is None


@pytest.mark.system
@pytest.mark.timeout(900)
def test_a_folder_that_path_cannot_hold_is_refused_in_one_sentence(installed: WindowsPc) -> None:
    ended = installed.gateway("installation", "add-to-path", r"C:\a;b")
    assert ended.returncode == 2
    assert ended.stdout.count("\n") == 1
    assert r"C:\a;b has a semicolon in its name; install into another folder" in ended.stdout


_HEADER = struct.Struct("<I16sI")
_HEADER_SIZE = 0x4C
_CLASS = UUID("00021401-0000-0000-c000-000000000046")

_HAS_ID_LIST, _HAS_LINK_INFO, _IS_UNICODE = 0x01, 0x02, 0x80
# In the order in which they follow each other (section 2.4).
_STRINGS = {
    "name": 0x04,
    "relative_path": 0x08,
    "working_folder": 0x10,
    "arguments": 0x20,
    "icon": 0x40,
}

# LinkInfo (section 2.3): its size, that of its header, flags, four offsets.
_LINK_INFO = struct.Struct("<7I")
_VOLUME_AND_LOCAL_BASE_PATH = 0x01


class ShortcutError(ValueError):
    """Bytes that are no shortcut to a local file."""


@dataclass(frozen=True, slots=True)
class Shortcut:
    """What a shortcut opens."""

    target: str  # The program, in the code page of the PC; empty if it is only told as an ID list.
    # arguments, working_folder, icon: as they are written; empty where absent.
    arguments: str = ""
    working_folder: str = ""
    icon: str = ""


def read_shortcut(path: Path) -> Shortcut:
    """Read a ``.lnk`` file.

    Raises
    ------
    ShortcutError
        It is none.
    """
    content = path.read_bytes()
    try:
        return _shortcut(content)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise ShortcutError(f"{path}: cut off or damaged: {error}") from error


def _shortcut(content: bytes) -> Shortcut:
    size, class_id, flags = _HEADER.unpack_from(content)
    if size != _HEADER_SIZE or UUID(bytes_le=class_id) != _CLASS:
        raise ShortcutError("the file has no shortcut's header")
    position, target = _HEADER_SIZE, ""
    if flags & _HAS_ID_LIST:
        position += 2 + _uint16(content, position)
    if flags & _HAS_LINK_INFO:
        info_size, target = _local_target(content[position:])
        position += info_size
    strings: dict[str, str] = {}
    for name, flag in _STRINGS.items():
        if flags & flag:
            strings[name], position = _string(content, position, wide=bool(flags & _IS_UNICODE))
    return Shortcut(
        target,
        strings.get("arguments", ""),
        strings.get("working_folder", ""),
        strings.get("icon", ""),
    )


def _local_target(info: bytes) -> tuple[int, str]:
    """Return the size of a LinkInfo and the path in it."""
    size, _, flags, _, base, _, suffix = _LINK_INFO.unpack_from(info)
    if not flags & _VOLUME_AND_LOCAL_BASE_PATH:
        return size, ""
    return size, _terminated(info, base) + _terminated(info, suffix)


def _terminated(content: bytes, start: int) -> str:
    # The code page is that of the PC, which is not told.
    return content[start : content.index(0, start)].decode("cp1252")


def _string(content: bytes, position: int, *, wide: bool) -> tuple[str, int]:
    """Return a counted string and where the next one begins."""
    start = position + 2
    end = start + _uint16(content, position) * (2 if wide else 1)
    if end > len(content):
        raise IndexError("a string ends after the file")
    text = content[start:end].decode("utf-16-le" if wide else "cp1252")
    # Wine counts and writes an end that the format does not have.
    return text.removesuffix("\0"), end


def _uint16(content: bytes, position: int) -> int:
    (value,) = struct.unpack_from("<H", content, position)
    return int(value)
