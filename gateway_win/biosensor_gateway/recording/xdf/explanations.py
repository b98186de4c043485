"""Explains findings about a recording: what each means for a study, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Explanation(NamedTuple):
    """The explanation of the findings of one code."""

    title: str  # What it is, in a few words.
    means: str
    to_do: str


EXPLANATIONS: Mapping[str, Explanation] = {
    "no-rate": Explanation(
        "A signal whose header names no rate",
        "Nothing is wrong with its samples; programs that use the header treat it as irregular.",
        "Nothing; exports use the stated rate. If you know a better one, export with `--rate`.",
    ),
    "damaged": Explanation(
        "Part of the file cannot be read",
        "The samples of that part are lost; everything before and after it was read.",
        "Run `xdf salvage` and use the file that it writes; keep the original. If it happens "
        "again, test the disk.",
    ),
    "foreign-chunk": Explanation(
        "A chunk of unknown kind",
        "The recorder wrote something that the format does not define, so no program can show"
        " it. All samples around it were read.",
        "Nothing, unless the footers' counts also differ. Then a chunk of samples is damaged, "
        "and `xdf salvage` leaves it out.",
    ),
    "no-header": Explanation(
        "Samples without a header",
        "The information about these samples is missing, so no program can read them.",
        "Run `xdf salvage --header-from` with another recording of the same streams.",
    ),
    "one-number": Explanation(
        "Two streams with the same number",
        "The file may hold two recordings, perhaps of two people, one after the other. Here each "
        "stream is kept apart; other programs read one of the two, or both as one.",
        "Run `xdf salvage`, which gives each stream its own number.",
    ),
    "no-streams": Explanation(
        "No streams",
        "The file contains no data of a session.",
        "Look for another file of that session, and select the streams before you record.",
    ),
    "no-samples": Explanation(
        "A stream without samples",
        "The sensor sent nothing while this was recorded, or a marker was never set.",
        "Leave the stream out of the analysis. Before the next session, check that the sensor"
        " is streaming, and set a marker at the start.",
    ),
    "not-closed": Explanation(
        "The file was not closed",
        "The recorder was killed or crashed; the last half second may be missing, and some "
        "programs cannot open the file.",
        "Run `xdf salvage`, and always end recordings with `record stop` or LabRecorder's *Stop*.",
    ),
    "late-stream": Explanation(
        "A stream appeared after the recording began",
        "Recorders search for streams at the start only, so nothing of this stream is in the file: "
        "often the markers of an experiment that was started after the recording.",
        "Start the programs first, look whether the recorder lists their streams, then record.",
    ),
    "file-gone": Explanation(
        "The file is gone",
        "It was moved, renamed, deleted or replaced during the recording. The recorder may go on "
        "writing to the moved file, but not to a disk that was taken away.",
        "Stop the recording, look for the file, and never move a file before its recording ends.",
    ),
    "going-on": Explanation(
        "The file is still being recorded",
        "What comes later is not judged, and exports are refused until the recording has ended.",
        "End it with `record stop`, which checks it.",
    ),
    "no-footer": Explanation(
        "A stream was not closed",
        "Its last samples may be missing. A stream without a source_id loses all that its program "
        "sends after it was started again.",
        "Give the streams of your programs a source_id. Run `xdf salvage`, and compare the end of "
        "the stream with that of the others.",
    ),
    "footer-count": Explanation(
        "The footer has a different sample count",
        "The recorder did not write as many samples as it counted. If it counted one less, "
        "nothing is missing: older versions of LabRecorder do not count the first sample.",
        "If the counts differ by more than one, compare the end of the stream with that of "
        "the others.",
    ),
    "other-participants": Explanation(
        "File name and sensors have different participants",
        "Either the file has the wrong name, or a participant wore a sensor that was set up "
        "for someone else.",
        "Check your notes, and export with `--whose sensors` or `--whose name`.",
    ),
    "missing": Explanation(
        "An expected stream is missing",
        "It was not recorded.",
        "Check that its sensor was switched on and that the recorder could see the stream; "
        "see `doctor`.",
    ),
    "expected-empty": Explanation(
        "An expected stream is empty",
        "The stream existed, but its sensor sent nothing.",
        "Check the sensor's battery, position and connection; see its page.",
    ),
    "duplicate-source-id": Explanation(
        "A source_id occurs twice",
        "Two programs use the same id, or a stream was recorded twice; samples may be duplicated.",
        "Compare the two streams, and use one of them. Run only one agent for each sensor.",
    ),
    "duplicate-name": Explanation(
        "A name occurs twice",
        "Programs that find a stream by its name may take either one.",
        "Use their source_id to distinguish them; exports number them.",
    ),
    "not-aligned": Explanation(
        "Streams that cannot be aligned",
        "They come from several computers, and the differences between their clocks were "
        "never measured.",
        "Analyse these streams separately, or align them by an event that is visible in all "
        "of them. Check the network with `doctor`.",
    ),
    "replay": Explanation(
        "A replay",
        "These samples were replayed from an older recording, and not measured live.",
        "Use the original recording, unless this was a test.",
    ),
    "robot-clock": Explanation(
        "The robot's clock is uncertain",
        "The timestamps of its topics may be wrong by the stated amount.",
        "Synchronise the robot's clock with NTP or chrony, and correct the timestamps if you "
        "know the error.",
    ),
    "absent": Explanation(
        "A sensor was never connected",
        "It is in the settings but was never connected, so none of its data was recorded.",
        "Nothing, if you did not use it; otherwise see the sensor's page.",
    ),
    "left-out": Explanation(
        "A stream was not recorded",
        "The agent sent the stream, but the recorder did not record it.",
        "Update LabRecorder's list of streams before you start, or use `record start`, which "
        "waits for all streams.",
    ),
    "removed": Explanation(
        "A sensor was removed or renamed during the recording",
        "From then on its streams had other names, which the recorder did not know.",
        "Use the data before that time; only change settings between recordings.",
    ),
    "another-agent": Explanation(
        "The recorder continued with another agent",
        "LabRecorder finds a stream that ended again by its source_id alone, also in another LSL "
        "session.",
        "Use the data before that time only. Give each room its own participant names; the "
        "`doctor` command shows where another session has the same source_id.",
    ),
    "away": Explanation(
        "A sensor was disconnected for a while",
        "It was paused or not connected, and nothing was measured during that time.",
        "Leave that time out of the analysis of this sensor.",
    ),
    "silent": Explanation(
        "A sensor was connected but sent nothing for a while",
        "Its data was delayed in the device or on the radio, or lost; losses are counted.",
        "Look at the gaps and counts of its streams; wear it on the side facing the receiver.",
    ),
    "clock-jumped": Explanation(
        "Timestamps of a sensor jumped",
        "The device's clock was set, or its first data were delayed: the timestamps just "
        "before were wrong by about the size of the jump.",
        "Compare the seconds before each jump with another sensor, or leave them out of the "
        "analysis.",
    ),
    "refused": Explanation(
        "The agent did not pass on all data unchanged",
        "Values were suppressed, changed, or stamped with their arrival time; the sentence "
        "says which.",
        "Leave these samples out of the analysis, and fix the cause named in the sentence.",
    ),
    "int64": Explanation(
        "An int64 stream",
        "LabRecorder cannot record this format, so the file has only the header of the stream.",
        "Let its program send int32 or double64, or use the gateway's own recorder.",
    ),
    "refused-header": Explanation(
        "An invalid gateway header",
        "The header looks like one of this program's but is invalid, so the stream is treated"
        " as another program's.",
        "Find out which program sent it, and update that program.",
    ),
    "not-utf8": Explanation(
        "Characters are guessed",
        "The program did not use UTF-8. Accented letters are read in the encoding of Western "
        "European Windows, which may be wrong; numbers and times are right.",
        "Check such texts, and let the program send UTF-8.",
    ),
    "no-source-id": Explanation(
        "No source_id",
        "If its program restarts, the recorder cannot recognise the stream and stops recording it.",
        "Let the program set a source_id, and start it before the recording.",
    ),
    "wrong-clock": Explanation(
        "Timestamps of another clock",
        "The time of these samples relative to the other streams is unknown.",
        "Analyse the stream separately, or align it by an event that is visible in both. Its "
        "program should send timestamps of LSL's clock, or none.",
    ),
    "bad-stamps": Explanation(
        "Invalid timestamps",
        "The time of these samples is unknown; exports leave them out.",
        "Report it to the author of the sending program.",
    ),
    "stray-stamps": Explanation(
        "Single timestamps far off",
        "Single samples have a timestamp far from their neighbours'; their values seem to be "
        "right. At the very end, this is garbage of a stream that ended while it was "
        "recorded.",
        "Leave these samples out; `xdf salvage` removes those at the end.",
    ),
    "late-first": Explanation(
        "The first samples came late",
        "Samples that a sensor measured before the connection was ready arrived together and were "
        "stamped at arrival, so the following timestamps step back. Nothing is lost.",
        "Nothing for EDF, Kubios, BIDS and features, which use the times of a line through all "
        "timestamps. In CSV, leave the first seconds out.",
    ),
    "standstill": Explanation(
        "Timestamps stand still",
        "The sender's clock stopped while it continued to send, so only the order of these "
        "samples is known.",
        "Do not compare these seconds with other streams. EDF, Kubios and BIDS treat the samples "
        "as evenly spaced.",
    ),
    "backwards": Explanation(
        "Time runs backwards",
        "The clock was set or the program was restarted, so samples may be duplicated or out "
        "of order.",
        "Check these places; in EDF and Kubios, each one starts a separate run.",
    ),
    "bursts": Explanation(
        "Timestamps in bursts",
        "The program gives many samples at once their arrival time. Nothing is lost, but the "
        "times of single samples are only known to within the length of a burst.",
        "Use the stated rate, as the exports to EDF, Kubios and BIDS do, and let your "
        "analysis smooth the timestamps when loading (pyxdf does by default).",
    ),
    "overlaps": Explanation(
        "Timestamps from arrival times",
        "Packets were sometimes late, so timestamps overlap. Nothing is lost.",
        "Use the stated rate, as the exports to EDF, Kubios and BIDS do, and let your "
        "analysis smooth the timestamps when loading (pyxdf does by default).",
    ),
    "gaps": Explanation(
        "Gaps",
        "Samples were lost, usually on the radio; nothing was filled in.",
        "Leave the gaps out of the analysis. Wear the sensor on the side facing the receiver,"
        " and keep other radios away.",
    ),
    "paused": Explanation(
        "Pauses",
        "Its sensor was paused, as after a withdrawal, so that nothing was sent; nothing is lost.",
        "Leave that time out of the analysis of this sensor.",
    ),
    "smeared-gaps": Explanation(
        "Gaps that loaders smooth out",
        "The header does not say that samples may be missing, so pyxdf and MATLAB's loader "
        "distribute short gaps over the whole recording.",
        "Load it with `dejitter_timestamps=False`, or use an export of this program.",
    ),
    "held-up": Explanation(
        "The computer was too busy",
        "The agent's reports were late. Streams with arrival times as timestamps, such as a "
        "heart rate, may be late by the same amount.",
        "Close other programs while you record; see `doctor`.",
    ),
    "rate": Explanation(
        "The rate differs from the header",
        "Analyses that use the rate in the header get wrong times and frequencies.",
        "Use the measured rate, as exports do.",
    ),
    "rate-change": Explanation(
        "The rate changes during the recording",
        "From that time on, the sampling rate is different. Loaders that use one rate for the "
        "whole stream give wrong times.",
        "EDF, Kubios, BIDS and features have a file or part for each rate; otherwise analyse the "
        "time before and after separately.",
    ),
    "repeated": Explanation(
        "Samples that are in the file twice",
        "The recorder wrote a block of samples once more. Nothing is missing. This program uses "
        "each sample once; pyxdf and EEGLAB load both, and their times step back there.",
        "Run `xdf salvage`, which writes a file with each sample once, for other programs.",
    ),
    "bent": Explanation(
        "The rate changes a little during the recording",
        "The sender's clock became faster or slower, or its rate changed by a few percent. Formats "
        "and loaders with one rate for all samples give times that are wrong by up to the stated "
        "seconds in the middle of the recording; no sample is missing for this reason.",
        "Use the times of CSV or MCAP, or load the file with `dejitter_timestamps=False`. For EDF "
        "and Kubios, write shorter parts with the command `xdf export --from START --until END`.",
    ),
    "no-offsets": Explanation(
        "Clock offsets were not measured",
        "This does not matter for streams of the recording computer, but streams of other "
        "computers cannot be aligned.",
        "Record for at least ten seconds, and allow LSL's ports in the firewall.",
    ),
    "clock-set": Explanation(
        "A computer slept, or its clock was set",
        "While it sleeps, a computer receives nothing. On Linux and macOS LSL's clock then stands "
        "still, so that the timestamps before and after look as if there was no gap. If the clock "
        "was set, LSL's timestamps are right, but times of day in MCAP, BIDS and ROS jump by that.",
        "Prevent sleep and let the clock synchronise before you record; see `doctor`. Treat a "
        "sleep as a gap, and do not analyse intervals across it.",
    ),
    "no-answer": Explanation(
        "A program was away",
        "The recorder got no answer and no sample from the program of a stream that has no rate. "
        "It had ended, or its computer was out of reach; what it would have sent then is not in "
        "the file. Streams with a rate have gaps instead.",
        "Nothing, if it was to send nothing then, as an experiment that was over. Otherwise leave "
        "that time out.",
    ),
    "offset-scatter": Explanation(
        "Clock offsets scatter",
        "Times of streams of other computers are less exact than usual, by about the stated "
        "amount.",
        "Use a cable instead of Wi-Fi, or a separate network.",
    ),
    "clock-reset": Explanation(
        "The sender's clock restarted",
        "Its computer was restarted or its clock was set. Times are right before and after "
        "that moment, but unknown around it.",
        "Find out what happened, and treat it as a gap.",
    ),
    "unused-offsets": Explanation(
        "Clock offsets that cannot be right",
        "Some of its clock offsets would put it weeks or years away from its others, for example "
        "because a computer's clock was set while it answered. They are not used; all others "
        "are.",
        "Nothing, if it is one of many. Otherwise compare its times with another stream's, such as "
        "one event that both show.",
    ),
    "drift": Explanation(
        "A clock drifts",
        "One of the computers has an inaccurate clock, or its clock was adjusted during the "
        "recording. Times are corrected by the measured offsets.",
        "Nothing, if it is below 1000 ppm; otherwise synchronise the computers' clocks.",
    ),
    "begins-late": Explanation(
        "Begins late",
        "It has no data in the first seconds.",
        "Start the analysis later; start recordings when all sensors are streaming.",
    ),
    "ends-early": Explanation(
        "Ends early",
        "It has no data in the last seconds, because of the battery, the radio or its program.",
        "End the analysis earlier, and check the sensor's battery.",
    ),
    "no-values": Explanation(
        "A channel without values",
        "The device does not measure it, or had no skin contact.",
        "Leave the channel out of the analysis.",
    ),
    "nan": Explanation(
        "Samples without a value",
        "The device reported that it could not measure, usually because it had no skin contact.",
        "Treat them as missing values; nothing was filled in.",
    ),
    "not-recorded": Explanation(
        "Sent but not recorded",
        "The agent sent samples that the recorder did not write to the file.",
        "Treat it as a gap of that many samples. Do not use the recording computer for other "
        "work, and wait a second before you stop.",
    ),
    "too-many": Explanation(
        "More samples than sent",
        "Two agents were running, or samples are duplicated.",
        "Look for equal timestamps; run only one agent for each sensor.",
    ),
    "flat": Explanation(
        "A channel that does not change",
        "The channel had one value for longer than a signal of the body can: a dead electrode, a "
        "cable, a converter at its limit, or an input that is not used.",
        "Leave the channel out of the analysis; if its input is not used, nothing else is wrong. "
        "Otherwise check the electrode before the next session. A channel with only its "
        "converter's noise is not detected, because its values change: look at the traces.",
    ),
    "lost": Explanation(
        "Lost between device and agent",
        "According to the device's sample numbers, samples were lost, usually on the radio.",
        "Leave the gaps out of the analysis. Wear the sensor on the side facing the receiver.",
    ),
    "restarted": Explanation(
        "The agent was restarted",
        "Nothing was measured between its end and its restart.",
        "Treat it as a gap, and look for the reason in the agent's log.",
    ),
    "off": Explanation(
        "Switched off",
        "The stream is switched off in the settings, or the device's model does not have it, or "
        "has it without these channels.",
        "Nothing, if you do not need it; otherwise switch it on in the settings.",
    ),
    "counters": Explanation(
        "The agent's counts cannot be read",
        "The recording cannot be compared with the data sent.",
        "Report it to us, with the version of the agent that made the recording.",
    ),
    "no-counters": Explanation(
        "The agent's counts were not recorded",
        "Only timestamps show whether samples are missing.",
        "Also record `gateway/counters`.",
    ),
    "told": Explanation(
        "A message of the recorder",
        "Something happened during the recording.",
        "Read the sentence, and add it to your notes on the session.",
    ),
    "ended": Explanation(
        "The recorder has stopped",
        "Nothing was recorded after that.",
        "Start another recording at once; this one can still be used or salvaged.",
    ),
    "unreadable": Explanation(
        "The file cannot be read now",
        "Another program is using it, or the disk is not available.",
        "Check the disk and the folder.",
    ),
    "no-agent": Explanation(
        "No agent",
        "No sensors of this program are being recorded.",
        "Start the agent, unless you only record other programs.",
    ),
    "little-space": Explanation(
        "Little disk space left",
        "The recording will end when the disk is full.",
        "Free some space while the recording continues.",
    ),
    "still": Explanation(
        "The file is not growing",
        "Nothing is being recorded.",
        "Check the recorder and the disk; start another recording if it does not recover.",
    ),
    "not-begun": Explanation(
        "A stream has not started",
        "The recording runs, but has no sample of this stream yet.",
        "Wait until this disappears before you start; if it stays, check its sensor.",
    ),
    "stopped": Explanation(
        "A stream has stopped",
        "Other streams continue, but this one has no new data.",
        "Check its sensor.",
    ),
}
"""By the codes of findings, in the order of the page that is made of it."""
