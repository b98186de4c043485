"""What the installer says and leaves when something runs, or a choice cannot be met.

With a program in the place of the real one, which does nothing but tell what it is asked.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Generator
from pathlib import Path

import pytest

from installer.layout import BIN, PROGRAM, WORK
from installer.stages import Build
from installer.wine.recipe import PICTURES, PREFIX
from tests.rigs.windows.pc import UNINSTALL_KEY, WindowsPc
from tests.rigs.windows.program import wait_until
from tests.rigs.windows.registry import DEFAULT_FOLDER
from tests.rigs.windows.stub import make_stub_setup

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

DONE, NOT_DONE, RUNS, INCOMPLETE = 0, 2, 3, 4
HELD = "4"


@pytest.fixture(scope="module")
def stub_setup(tmp_path_factory: pytest.TempPathFactory) -> Path:
    build = Build(WORK)
    for stage in (PREFIX, PICTURES):
        build.bring_up_to_date(stage)
    return make_stub_setup(tmp_path_factory.mktemp("stub"))


@pytest.fixture
def stub_pc(disk: Path, stub_setup: Path) -> Generator[WindowsPc]:
    """A PC with the stub."""
    with WindowsPc(disk) as pc:
        assert pc.install(stub_setup).returncode == DONE
        calls(pc).unlink()
        yield pc


def calls(pc: WindowsPc) -> Path:
    return pc.drive_c / "calls.txt"


def asked(pc: WindowsPc) -> list[str]:
    """What the program was asked, but for what it is asked in any case."""
    lines = calls(pc).read_text().splitlines() if calls(pc).exists() else []
    return [each for each in lines if each.split()[0] in {"record", "page", "stop"}]


def running(pc: WindowsPc) -> subprocess.Popen[bytes]:
    process = pc.prefix.start(pc.program, "run")
    wait_until(lambda: calls(pc).exists() and "run" in calls(pc).read_text(), "the stub runs")
    return process


def end(pc: WindowsPc, process: subprocess.Popen[bytes]) -> None:
    (pc.drive_c / "end").touch()
    process.communicate(timeout=60)


def test_the_recording_is_ended_before_its_streams(stub_pc: WindowsPc, stub_setup: Path) -> None:
    process = running(stub_pc)
    ended = stub_pc.prefix.attempt(stub_setup, "/S", "/FORCE=1")
    end(stub_pc, process)
    assert ended.returncode == DONE
    assert asked(stub_pc)[:3] == ["record stop", "page --end", "stop --while-recording"]


def test_nothing_is_closed_unless_all_can_be(stub_pc: WindowsPc, stub_setup: Path) -> None:
    (stub_pc.drive_c / "holders.txt").write_text(HELD)
    process = running(stub_pc)
    uninstaller = stub_pc.program_folder / "uninstall.exe"
    in_place = f"_?={DEFAULT_FOLDER}".split(" ")
    for line in ([stub_setup, "/S", "/FORCE=1"], [uninstaller, "/S", "/FORCE=1", *in_place]):
        assert stub_pc.prefix.attempt(*line).returncode == NOT_DONE
    assert process.poll() is None
    assert asked(stub_pc) == []
    end(stub_pc, process)


def test_the_quiet_uninstall_string_tells_what_came_of_it(stub_pc: WindowsPc) -> None:
    found = stub_pc.registry(UNINSTALL_KEY)
    assert found is not None
    quiet = found["QuietUninstallString"]
    assert quiet == rf'"{DEFAULT_FOLDER}\uninstall.exe" /S _?={DEFAULT_FOLDER}'
    batch = stub_pc.drive_c / "quiet.bat"
    batch.write_text(f"@{quiet}\r\n@exit /b %errorlevel%\r\n")
    process = running(stub_pc)
    assert stub_pc.prefix.attempt("cmd", "/c", r"C:\quiet.bat").returncode == RUNS
    assert stub_pc.program.is_file()
    end(stub_pc, process)
    assert stub_pc.prefix.attempt("cmd", "/c", r"C:\quiet.bat").returncode == DONE
    # It cannot delete itself before it has ended.
    wait_until(lambda: not stub_pc.program_folder.exists(), "the folder is gone")
    stub_pc.prefix.settle()
    assert stub_pc.registry(UNINSTALL_KEY) is None


def test_nothing_that_others_can_replace_is_run_as_administrator(
    disk: Path, stub_setup: Path
) -> None:
    with WindowsPc(disk) as pc:
        outside = pc.drive_c / "Everybody" / "Gateway"
        into = (r"/D=C:\Everybody\Gateway",)
        assert pc.install(stub_setup, "/AUTOSTART=1", *into).returncode == DONE
        program = outside / BIN / f"{PROGRAM}.exe"
        # Somebody has put another program in the place of the uninstaller.
        shutil.copy(program, outside / "uninstall.exe")
        stale = outside / BIN / "_internal" / "of_an_earlier_version.dll"
        stale.touch()
        calls(pc).unlink()
        process = pc.prefix.start(program, "run")
        wait_until(lambda: calls(pc).exists() and "run" in calls(pc).read_text(), "the stub runs")
        places = pc.drive_c / "places.txt"
        (by_user, *_) = places.read_text().splitlines()[-1:]
        assert by_user.startswith(r"C:\Everybody")
        places.unlink()
        assert pc.prefix.attempt(stub_setup, "/S", "/FORCE=1").returncode == DONE
        end(pc, process)
        assert asked(pc)[:3] == ["record stop", "page --end", "stop --while-recording"]
        assert "installation autostart-state" in calls(pc).read_text()
        assert program.is_file()
        assert not stale.exists()
        run_from = places.read_text().splitlines()
        assert run_from
        assert [each for each in run_from if each.startswith(r"C:\Everybody")] == []
        # What is moved to where only administrators can change it runs there.
        places.unlink()
        assert pc.install(stub_setup, *f"/D={DEFAULT_FOLDER}".split(" ")).returncode == DONE
        assert not outside.exists()
        assert pc.program.is_file()
        run_from = places.read_text().splitlines()
        assert [each for each in run_from if each.startswith(r"C:\Everybody")] == []
        assert run_from[-1].startswith(DEFAULT_FOLDER)


def test_choices_that_were_not_met_are_told_by_the_code(
    stub_pc: WindowsPc, stub_setup: Path
) -> None:
    answers = {
        name: stub_pc.drive_c / f"{name}.txt"
        for name in ("autostart", "autostart-state", "add-to-path")
    }
    # It was not chosen before.
    answers["autostart-state"].write_text("3")
    answers["autostart"].write_text("1")
    assert stub_pc.install(stub_setup, "/AUTOSTART=1").returncode == INCOMPLETE
    assert stub_pc.program.is_file()
    assert stub_pc.install(stub_setup).returncode == DONE
    answers["add-to-path"].write_text("1")
    assert stub_pc.install(stub_setup).returncode == INCOMPLETE
    answers["add-to-path"].unlink()
    netsh = stub_pc.drive_c / "windows" / "system32" / "netsh.exe"
    netsh.unlink()
    netsh.write_text("no program")
    assert stub_pc.install(stub_setup, "/FIREWALL=1").returncode == INCOMPLETE
    assert stub_pc.program.is_file()
