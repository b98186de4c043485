"""On a disk that is full or may not be written, each command says so and leaves nothing behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export.job import Task, export
from tests.recording_export import odd_shapes
from tests.recording_export.study import BEGIN_S, ecg_values, ours, study
from tests.xdf import xdf_file as made

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


def run_with_mounts(script: str) -> str:
    """Run a script whose mounts nobody else sees; return what it prints."""
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=DEADLINE_S,
        check=True,
    )
    return done.stdout


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
    return run_with_mounts(script), places["before"].read_text() == places["after"].read_text()


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


def test_a_withdrawal_on_a_full_disk_loses_nothing_and_goes_on(tmp_path: Path) -> None:
    """A person's own file makes room for the small ones, and the large one waits for more."""
    stamps = BEGIN_S + np.arange(40_000) / 130
    both = [
        ours(at, "polar_h10", "ecg", ecg_values(len(stamps), at), stamps, name)
        + made.footer(at, len(stamps))
        for at, name in enumerate(("P07", "P08"), 1)
    ]
    (tmp_path / "a.xdf").write_bytes(made.xdf(*both))
    (tmp_path / "sub-P07_beh.xdf").write_bytes(made.xdf(both[0][: len(both[0]) // 20]))
    (tmp_path / "disk").mkdir()
    script = f"""
    set -e
    mount -t tmpfs -o size=2m tmpfs {tmp_path}/disk
    cd {tmp_path}/disk
    mkdir study
    cp {tmp_path}/*.xdf study
    printf 'P07 was tired\nnobody else was\n' > study/notes.txt
    dd if=/dev/zero of=fill bs=1k 2>/dev/null || true
    before=$(sha256sum < study/a.xdf)
    set +e
    {PROGRAM} withdraw P07 study --yes
    echo "exit code $?"
    test "$before" = "$(sha256sum < study/a.xdf)" && echo as before
    ls -A study
    rm fill
    {PROGRAM} withdraw P07 study --yes
    echo "exit code $?"
    {PROGRAM} xdf export study/a.xdf --to csv --output {tmp_path}/a_csv
    """
    said = run_with_mounts(script)
    first, _, second = said.partition("as before\n")
    (undone,) = (line for line in first.splitlines() if line.startswith("not done: "))
    assert "study/a.xdf" in undone
    assert undone.endswith(
        "free some space on that disk, and give the command again: the rest is done"
    )
    assert "exit code 1" in first
    assert second.splitlines()[:2] == ["a.xdf", "notes.txt"]
    assert "exit code 0" in second
    (table,) = (tmp_path / "a_csv").glob("P0*.csv")
    assert table.name.startswith("P08")
    assert len(table.read_text().splitlines()) == 1 + len(stamps)


def test_a_withdrawal_does_nothing_if_its_report_cannot_be_written(tmp_path: Path) -> None:
    command = "withdraw P1 . --yes --report report.json"
    said, is_as_before = _said(command, "read-only", tmp_path)
    *plan, sentence, code = said.splitlines()
    assert all(line.startswith(("rewrite: ", "delete: ", " ")) for line in plan)
    assert sentence.startswith("biosensor-gateway: cannot write report.json: Read-only file system")
    assert code == "exit code 1"
    assert is_as_before
