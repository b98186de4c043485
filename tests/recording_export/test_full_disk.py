"""On a disk that is full or may not be written, each command says so and leaves nothing behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.exporting import Task, export
from tests.recording_export import odd_shapes
from tests.recording_export.study import study

pytestmark = pytest.mark.system

PROGRAM = f"{sys.executable} -m biosensor_gateway.cli"
DEADLINE_S = 120.0
# Nobody else sees the disk, and it goes with the process.
ON_A_SMALL_DISK = """
set -e
mount -t tmpfs -o size=2m tmpfs {disk}
cd {disk}
cp {whole} {cut} .
cp -r {bag} bag
printf 'P1 was tired\nnobody else was\n' > notes.txt
find . -type f ! -name fill | sort | xargs sha256sum > {before}
{spoil}
set +e
{command}
echo "exit code $?"
rm -f fill
find . -type f | sort | xargs sha256sum > {after}
"""
SPOILT = {
    "full": "dd if=/dev/zero of=fill bs=1k 2>/dev/null || true",
    "read-only": "mount -o remount,ro {disk}",
}
COMMANDS = {
    "features": "features study.xdf",
    "features, a table": "features study.xdf --output table.csv",
    "salvage": "xdf salvage cut.xdf",
    "import": "bag import bag --output bag.xdf",
    "csv": "xdf export study.xdf --to csv",
    "csv.gz": "xdf export study.xdf --to csv.gz",
    "edf": "xdf export study.xdf --to edf",
    "bids": "xdf export study.xdf --to bids",
    "mcap": "xdf export study.xdf --to mcap",
}


def _said(command: str, spoilt: str, folder: Path) -> tuple[str, bool]:
    """Return what a command says on such a disk, and whether the disk's files are as before."""
    (folder / "disk").mkdir()
    (folder / "study.xdf").write_bytes(study())
    (folder / "cut.xdf").write_bytes(odd_shapes.files()["cut off"][1])
    task = Task(["mcap"], Selection(), output=folder)
    (bag,) = export(folder / "study.xdf", task, lambda _n, _s: lambda _done: None).written
    places = {name: folder / name for name in ("disk", "before", "after")}
    script = ON_A_SMALL_DISK.format(
        whole=folder / "study.xdf",
        cut=folder / "cut.xdf",
        bag=bag.path,
        command=f"{PROGRAM} {command}",
        spoil=SPOILT[spoilt].format(**places),
        **places,
    )
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=DEADLINE_S,
        check=True,
    )
    return done.stdout, places["before"].read_text() == places["after"].read_text()


@pytest.mark.parametrize("spoilt", SPOILT)
@pytest.mark.parametrize("command", COMMANDS)
def test_one_sentence_says_it_and_nothing_is_left(
    command: str, spoilt: str, tmp_path: Path
) -> None:
    said, is_as_before = _said(COMMANDS[command], spoilt, tmp_path)
    sentence, code = said.splitlines()
    assert code == "exit code 1"
    # What, where, and what to do.
    assert sentence.startswith(("biosensor-gateway: cannot write", "biosensor-gateway: the disk"))
    assert any(advice in sentence for advice in ("free some space", "choose a place on another"))
    assert is_as_before


@pytest.mark.parametrize("spoilt", SPOILT)
def test_a_withdrawal_says_of_each_file_that_it_was_not_done(spoilt: str, tmp_path: Path) -> None:
    said, is_as_before = _said("withdraw P1 . --yes", spoilt, tmp_path)
    undone = [line for line in said.splitlines() if line.startswith("not done: ")]
    assert len(undone) == 3
    assert all(": cannot write" in line for line in undone)
    assert said.count("still there: ") >= len(undone)
    assert said.splitlines()[-1] == "exit code 1"
    assert is_as_before


def test_a_withdrawal_does_nothing_if_its_report_cannot_be_written(tmp_path: Path) -> None:
    command = "withdraw P1 . --yes --report report.json"
    said, is_as_before = _said(command, "read-only", tmp_path)
    *plan, sentence, code = said.splitlines()
    assert all(line.startswith(("rewrite: ", "delete: ", " ")) for line in plan)
    assert sentence.startswith("biosensor-gateway: cannot write report.json: Read-only file system")
    assert code == "exit code 1"
    assert is_as_before
