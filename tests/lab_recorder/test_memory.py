"""What is known of a recording before it starts: its name, its participants, the last one."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.status_file import write_status
from biosensor_gateway.recording.participants import OtherParticipantsError, Worn
from biosensor_gateway.recording.recorder import recording_file
from biosensor_gateway.recording.recorder.labrecorder import RemoteControl
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.presence import (
    Presence,
    expected_devices,
    require_startable,
)
from biosensor_gateway.recording.recorder.recording_file import (
    grows,
    sizes,
    summarize,
    wait_for_growth,
    wait_until_closed,
)
from biosensor_gateway.recording.recorder.request import (
    BidsLabels,
    RecorderError,
    RecorderReason,
    RecordingRequest,
    SensorsAwayError,
    Target,
    VisibleStream,
    choose_target,
)
from biosensor_gateway.recording.recorder.state import (
    WINDOW_FILE,
    WRITTEN_WITHIN_S,
    WindowRecording,
    file_going_on,
)
from biosensor_gateway.settings.models import GatewaySettings
from tests.lab_recorder.remote_control import LabRecorderPeer
from tests.recording_here.conftest import begin
from tests.xdf.xdf_file import FILE_HEADER, chunk, footer, samples, stream_header

# What is kept of the recording that was started last.

RECORDING = WindowRecording("127.0.0.1", 22345, "/data/a.xdf", 1795279855.5)


def test_it_is_kept_until_it_is_over(tmp_path: Path) -> None:
    folder = tmp_path / "not there yet"
    assert WindowRecording.last_at(folder, "127.0.0.1", 22345) is None
    assert RECORDING.save(folder) == ""
    assert WindowRecording.last_at(folder, "127.0.0.1", 22345) == RECORDING
    assert [path.name for path in folder.iterdir()] == [WINDOW_FILE]
    WindowRecording.forget(folder)
    WindowRecording.forget(folder)
    assert WindowRecording.last_at(folder, "127.0.0.1", 22345) is None


@pytest.mark.parametrize(
    ("host", "port", "is_known"),
    [
        ("localhost", 22345, True),
        ("::1", 22345, True),
        ("127.0.0.1", 22346, False),
        ("lab-pc", 22345, False),
    ],
)
def test_it_is_that_of_one_labrecorder(
    tmp_path: Path, host: str, port: int, is_known: bool
) -> None:
    RECORDING.save(tmp_path)
    assert (WindowRecording.last_at(tmp_path, host, port) is not None) is is_known


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b"\0", b"\xff", b"[" * 100_000, json.dumps({"host": "127.0.0.1"}).encode()],
)
def test_what_is_damaged_is_as_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / WINDOW_FILE).write_bytes(content)
    assert WindowRecording.last_at(tmp_path, "127.0.0.1", 22345) is None


def test_where_nothing_can_be_written_it_says_what_that_means(tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    assert "--file" in RECORDING.save(in_the_way)


@pytest.mark.parametrize(("age_s", "goes_on"), [(0.0, True), (2 * WRITTEN_WITHIN_S, False)])
def test_a_window_records_as_long_as_it_writes(age_s: float, goes_on: bool, tmp_path: Path) -> None:
    file = tmp_path / "a.xdf"
    assert file_going_on(tmp_path) is None
    WindowRecording("localhost", 22345, str(file), 1.0).save(tmp_path)
    assert file_going_on(tmp_path) is None
    file.touch()
    written = time.time() - age_s
    os.utime(file, (written, written))
    assert file_going_on(tmp_path) == (file if goes_on else None)
    WindowRecording.forget(tmp_path)
    assert file_going_on(tmp_path) is None


# Which name LabRecorder is told, and where its file will be.
LABELS = BidsLabels("P07", "S2", "Walk", 12, "left", "EEG")


def test_a_bids_name_is_told_with_placeholders_that_keep_their_case(tmp_path: Path) -> None:
    target = choose_target(RecordingRequest(tmp_path, labels=LABELS), is_local=True)
    name = "sub-P07/ses-S2/eeg/sub-P07_ses-S2_task-Walk_acq-left_run-012_eeg.xdf"
    assert target.files == (tmp_path / name,)
    assert target.template == target.template.lower()
    assert target.command.startswith(
        f"filename {{root:{tmp_path}}}{{template:sub-%p/ses-%s/%m/sub-%p_ses-%s_task-%b_acq-%a_run"
    )


def test_the_run_is_told_last_because_a_task_or_modality_resets_it() -> None:
    command = choose_target(RecordingRequest(Path("/data"), labels=LABELS), is_local=True).command
    assert command.endswith("{run:12}")
    assert command.index("{template:") < command.index("{task:") < command.index("{run:")


def test_without_an_acquisition_the_name_has_none() -> None:
    target = choose_target(RecordingRequest(Path("/data"), labels=BidsLabels("p1")), is_local=True)
    assert target.files[0].name == "sub-p1_ses-S001_task-Default_run-001_beh.xdf"
    assert "acq" not in target.command


def test_a_file_is_looked_for_in_lower_case_and_as_it_was_given(tmp_path: Path) -> None:
    target = choose_target(RecordingRequest(file=tmp_path / "Sub" / "Night.xdf"), is_local=True)
    assert target.files == (tmp_path / "Sub" / "night.xdf", tmp_path / "Sub" / "Night.xdf")
    assert target.command == f"filename {{root:{tmp_path / 'Sub'}}}{{template:night.xdf}}"


def test_a_relative_file_is_below_the_folder_else_below_the_working_folder() -> None:
    file = Path("day/one.xdf")
    assert choose_target(RecordingRequest(Path("/data"), file=file), is_local=True).files == (
        Path("/data/day/one.xdf"),
    )
    assert choose_target(RecordingRequest(file=file), is_local=True).files == (Path.cwd() / file,)


def test_another_computer_may_call_the_folder_differently(tmp_path: Path) -> None:
    file, there = Path("day/one.xdf"), "D:\\Studies"
    target = choose_target(RecordingRequest(tmp_path, there, file), is_local=False)
    assert target.command == "filename {root:D:\\Studies/day}{template:one.xdf}"
    assert target.files == (tmp_path / "day" / "one.xdf",)
    target = choose_target(RecordingRequest(tmp_path, there, labels=LABELS), is_local=False)
    assert "{root:D:\\Studies}" in target.command
    assert target.files[0].is_relative_to(tmp_path)


def test_of_another_computer_nothing_is_seen_without_a_folder() -> None:
    assert choose_target(RecordingRequest(), is_local=False).command == ""
    for place in (
        RecordingRequest(file=Path("one.xdf")),
        RecordingRequest(labels=LABELS),
        RecordingRequest(),
    ):
        target = choose_target(place, is_local=False)
        assert (target.folder, target.files, target.root) == (None, (), "")


def test_a_folder_alone_leaves_the_name_to_labrecorder(tmp_path: Path) -> None:
    target = choose_target(RecordingRequest(tmp_path), is_local=True)
    assert target.command == f"filename {{root:{tmp_path}}}"
    assert (target.folder, target.files) == (tmp_path, ())


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (RecordingRequest(), "--folder"),
        (RecordingRequest(file=Path("notes.txt")), ".xdf"),
        (RecordingRequest(file=Path("100%p.xdf")), "%"),
        (RecordingRequest(file=Path("a}{task:b.xdf")), "braces"),
        (RecordingRequest(Path("/a{b}"), labels=LABELS), "braces"),
        (RecordingRequest(Path("/a\nstop"), labels=LABELS), "control characters"),
        (RecordingRequest(Path("/data"), file=Path("one.xdf"), labels=LABELS), "not both"),
        (RecordingRequest(Path("/data"), file=Path("/one.xdf")), "relative to --folder"),
    ],
)
def test_what_makes_no_sense_is_refused(place: RecordingRequest, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        choose_target(place, is_local=True)
    assert caught.value.reason is ConfigReason.WRONG_VALUE


def test_a_path_of_this_computer_means_nothing_to_another() -> None:
    with pytest.raises(ConfigError, match="--recorder-folder"):
        choose_target(RecordingRequest(file=Path("/data/one.xdf")), is_local=False)


@pytest.mark.parametrize("label", ["p_01", "p-01", "p 01", "", "müller", "a}{run:2"])
def test_a_participant_is_a_bids_label(label: str) -> None:
    with pytest.raises(ConfigError, match="letters and digits"):
        BidsLabels(label)


@pytest.mark.parametrize("run", [0, 1001])
def test_a_run_is_what_labrecorder_s_field_takes(run: int) -> None:
    with pytest.raises(ConfigError, match="1000"):
        BidsLabels("p01", run=run)


# Who wears the sensors is compared with what the file is called, before anything is recorded.
SEEN = VisibleStream("P01-polar_h10-A1-ecg", "P01@polar_h10-ecg", "lab-pc")
PRESENCE = Presence((SEEN,), (), (), (Worn("polar_h10/A1", "P01"),))


def request(participant: str, **more: Any) -> RecordingRequest:
    return RecordingRequest(Path("/data"), labels=BidsLabels(participant), **more)


@pytest.mark.parametrize(
    "confirmed",
    [
        request("P01"),
        RecordingRequest(file=Path("walk.xdf")),
        RecordingRequest(Path("/data")),
        request("P03", other_participants=True),
    ],
)
def test_what_agrees_or_is_confirmed_is_recorded(confirmed: RecordingRequest) -> None:
    require_startable(PRESENCE, PRESENCE.visible, confirmed)


@pytest.mark.parametrize(
    "where", [request("P03"), RecordingRequest(file=Path("/data/sub-P03_task-a.xdf"))]
)
def test_another_participant_is_refused_and_the_option_named(where: RecordingRequest) -> None:
    with pytest.raises(OtherParticipantsError, match="--other-participants") as caught:
        require_startable(PRESENCE, PRESENCE.visible, where)
    # The command line makes exit code 2 of it.
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert "the file is called P03, but its sensors are worn by P01" in str(caught.value)


def test_nothing_is_made_of_a_recording_that_is_refused(tmp_path: Path) -> None:
    order = RecordingRequest(tmp_path, labels=BidsLabels("P03"))
    recording = LocalRecorder(tmp_path / "state")
    with pytest.raises(OtherParticipantsError):
        begin(recording, order, PRESENCE)
    assert list(tmp_path.rglob("*.xdf")) == []
    assert not recording.is_running


def test_a_sensor_that_does_not_stream_refuses_and_the_option_is_named(tmp_path: Path) -> None:
    presence = replace(PRESENCE, away=("P01's strap is paused since 14:03",))
    recording = LocalRecorder(tmp_path / "state")
    with pytest.raises(SensorsAwayError, match="P01's strap is paused since 14:03") as caught:
        begin(recording, RecordingRequest(tmp_path, labels=BidsLabels("P01")), presence)
    assert "--allow-missing" in str(caught.value)
    assert caught.value.reason is RecorderReason.STREAMS_MISSING
    assert list(tmp_path.rglob("*.xdf")) == []
    require_startable(presence, presence.visible, request("P01", without_away=True))


def test_what_the_agent_says_of_a_pause_is_known_before_it_begins(tmp_path: Path) -> None:
    known: dict[str, object] = {"sensor": "polar_h10", "participant": "P01", "label": "",
                                "error": None, "paused": False, "streams": {}}  # fmt: skip
    devices: list[dict[str, object]] = [
        {**known, "unit": "A1", "state": "streaming", "paused": True, "since": 1.0},
        {**known, "unit": "A2", "state": "streaming"},
        # A part of its streams may be all that it ever sends.
        {**known, "unit": "A3", "state": "streaming", "error": "no data of acc"},
        {**known, "unit": "A4", "state": "discovering", "since": 1.0},
    ]
    write_status(tmp_path, {"written": time.time(), "devices": devices})
    found = expected_devices(GatewaySettings(), tmp_path)
    told = [each.away.partition(" since ")[0] for each in found]
    assert told == ["P01's Polar H10 A1 is paused", "", "", "P01's Polar H10 A4 is not found"]


# The conversation with LabRecorder, on real sockets.

LOCAL = "127.0.0.1"
DEADLINE_S = 30.0


def reason_of(port: int, line: str = "update", limit_s: float = DEADLINE_S) -> RecorderError:
    with RemoteControl(LOCAL, port) as remote, pytest.raises(RecorderError) as caught:
        remote.command(line, limit_s)
    return caught.value


@pytest.mark.seam
def test_each_command_waits_for_the_answer_to_the_one_before(recorder: LabRecorderPeer) -> None:
    with RemoteControl(LOCAL, recorder.port) as remote:
        for line in ("update", "select none", "gibberish", "filename {task:A}"):
            remote.command(line)
        assert remote.is_local
    assert recorder.lines == ["update", "select none", "gibberish", "filename {task:A}"]


def test_nobody_there_is_said_with_what_to_do() -> None:
    with socket.create_server((LOCAL, 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(RecorderError, match="EnableRCS") as caught, RemoteControl(LOCAL, port):
        pass
    assert caught.value.reason is RecorderReason.UNREACHABLE
    assert f"{LOCAL}:{port}" in str(caught.value)


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a" * 70, "a..b"])
def test_a_host_that_cannot_be_found_is_unreachable(host: str) -> None:
    with pytest.raises(RecorderError) as caught, RemoteControl(host, 22345):
        pass
    assert caught.value.reason is RecorderReason.UNREACHABLE


@pytest.mark.nightly
def test_a_message_box_is_suspected_behind_silence(tmp_path: Path) -> None:
    root = tmp_path / "a file, so no folder can be made"
    root.touch()
    with LabRecorderPeer(root) as recorder:
        error = reason_of(recorder.port, "start", 5.0)
        assert "Can not create the directory" in recorder.box
    assert error.reason is RecorderReason.NO_REPLY
    assert "window" in str(error)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("answer", "reason", "said"),
    [
        (b"220 mail.example ESMTP\r\n", RecorderReason.REFUSED, "220 mail"),
        # It hangs up.
        (b"", RecorderReason.UNREACHABLE, "disappeared at 'update'"),
    ],
)
def test_who_answers_otherwise_is_no_labrecorder(
    answer: bytes, reason: RecorderReason, said: str
) -> None:
    with socket.create_server((LOCAL, 0)) as server:

        def serve() -> None:
            with server.accept()[0] as client:
                client.recv(100)
                client.sendall(answer)
                if answer:
                    client.recv(100)

        serving = threading.Thread(target=serve)
        serving.start()
        error = reason_of(server.getsockname()[1])
        serving.join(DEADLINE_S)
        assert not serving.is_alive()
    assert error.reason is reason
    assert said in str(error)


# When a recording counts as growing, and when as closed.

HEAD = b"XDF:" + chunk(1, FILE_HEADER) + stream_header(1, "one")
MORE = samples(1, "float32", [[1.0], [2.0]], [1.0, 2.0])
SHORT_S = 1.5


@contextmanager
def written(path: Path, first: bytes, block: bytes) -> Generator[None]:
    """Write a file as a recorder does: block after block, until the context ends."""
    ended = threading.Event()

    def write() -> None:
        with path.open("ab") as file:
            file.write(first)
            file.flush()
            while not ended.wait(0.1):
                file.write(block)
                file.flush()

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield
    finally:
        ended.set()
        writer.join()


@pytest.mark.nightly
def test_a_file_that_gets_samples_grows(tmp_path: Path) -> None:
    path = tmp_path / "a.xdf"
    with written(path, HEAD, MORE):
        assert wait_for_growth(Target(files=(path,)), {}, DEADLINE_S) == path
        assert grows(path, DEADLINE_S)


@pytest.mark.nightly
def test_headers_alone_are_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.xdf"
    with written(path, HEAD, stream_header(2, "two")):
        assert wait_for_growth(Target(files=(path,)), {}, SHORT_S) is None


@pytest.mark.nightly
@pytest.mark.parametrize("content", [b"", b"PK\3\4", HEAD + MORE])
def test_a_file_that_stays_as_it_is_does_not_grow(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(content)
    assert wait_for_growth(Target(files=(path,)), {}, SHORT_S) is None
    assert not grows(path, 0.5)


@pytest.mark.nightly
def test_in_a_folder_what_was_there_before_is_left_alone(tmp_path: Path) -> None:
    old = tmp_path / "old.xdf"
    old.write_bytes(HEAD + MORE + footer(1, 2))
    target = Target(folder=tmp_path)
    before = sizes(target)
    assert before == {old: old.stat().st_size}
    new = tmp_path / "deep" / "new.XDF"
    new.parent.mkdir()
    with written(tmp_path / "notes.txt", HEAD, MORE):
        assert wait_for_growth(target, before, SHORT_S) is None
    with written(new, HEAD, MORE):
        assert wait_for_growth(target, before, DEADLINE_S) == new


def test_what_is_not_there_does_not_grow(tmp_path: Path) -> None:
    assert wait_for_growth(Target(files=(tmp_path / "a.xdf",)), {}, 0.0) is None
    assert not grows(tmp_path / "a.xdf", 0.0)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("content", "is_closed"),
    [
        (HEAD + MORE + footer(1, 2), True),
        # LabRecorder cannot record these, and gives them no footer.
        (HEAD + MORE + footer(1, 2) + stream_header(2, "big", fmt="int64"), True),
        (HEAD + MORE, False),
        (HEAD + stream_header(2, "two") + footer(1, 0), False),
        ((HEAD + MORE + footer(1, 2))[:-5], False),
        (b"XDF:" + chunk(1, FILE_HEADER), False),
        (b"", False),
    ],
)
def test_a_recording_is_closed_once_all_its_streams_are(
    tmp_path: Path, content: bytes, is_closed: bool
) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(content)
    seen = summarize(path)
    assert seen.is_closed is is_closed
    assert seen.bytes == len(content)
    still = wait_until_closed(path, 0.5, DEADLINE_S)
    assert still is not None
    assert still.is_closed is is_closed


@pytest.mark.nightly
def test_what_goes_on_growing_is_not_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(HEAD)

    def grown(file: Path) -> int:
        with file.open("ab") as growing:
            growing.write(MORE)
        return file.stat().st_size

    # It grows from look to look, whoever is held up.
    monkeypatch.setattr(recording_file, "size_of", grown)
    begun = time.monotonic()
    assert wait_until_closed(path, 1.0, 3.0) is None
    assert time.monotonic() - begun >= 3.0
