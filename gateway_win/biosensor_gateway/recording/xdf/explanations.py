"""Explains findings about a recording: what each means for a study, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Explanation(NamedTuple):
    """Of findings of one code.

    Attributes
    ----------
    title
        What it is, in a few words.
    means
        What it means for a study.
    to_do
        What to do about it.
    """

    title: str
    means: str
    to_do: str


EXPLANATIONS: Mapping[str, Explanation] = {
    "damaged": Explanation(
        "A place cannot be read",
        "Samples of that place are lost; all before and behind it was read.",
        "Run `xdf salvage` and use the file that it writes; keep the original. If it happens "
        "again, test the disk.",
    ),
    "foreign-chunk": Explanation(
        "A chunk of an unknown kind",
        "The recorder wrote something that the format does not have; whatever it holds, no program "
        "shows it. All samples around it were read.",
        "Nothing, unless the counts of the footers differ, too; then a chunk of samples is "
        "damaged, and `xdf salvage` leaves it out.",
    ),
    "no-header": Explanation(
        "Samples without a header",
        "Nothing says what these samples are, so no program can read them.",
        "Run `xdf salvage --header-from` with another recording of the same streams.",
    ),
    "no-streams": Explanation(
        "No stream at all",
        "The file holds nothing of a session.",
        "Look for another file of that session; tick the streams before you record.",
    ),
    "no-samples": Explanation(
        "A stream without samples",
        "The sensor sent nothing while this was recorded, or a marker was never set.",
        "Leave the stream out of the analysis. Before the next session look whether the sensor "
        "streams; set a marker at the begin.",
    ),
    "not-closed": Explanation(
        "The file was not closed",
        "The recorder was ended or has died; the last half second may be missing, and some "
        "programs refuse the file.",
        "Run `xdf salvage`; end recordings by `record stop` or LabRecorder's *Stop*.",
    ),
    "no-footer": Explanation(
        "A stream was not closed",
        "Its last samples may be missing.",
        "Run `xdf salvage`, and compare its end with that of the other streams.",
    ),
    "footer-count": Explanation(
        "The footer counts other samples",
        "The recorder counted other samples than it wrote; of one less, older LabRecorders "
        "forget the first one and nothing is missing.",
        "If they differ by more than one, compare the end of the stream with that of the others.",
    ),
    "other-participants": Explanation(
        "Name and sensors name different people",
        "Either the file has the wrong name, or somebody wore a sensor that was set up for "
        "somebody else.",
        "Find out who it was from your notes, and export with `--whose sensors` or `--whose name`.",
    ),
    "missing": Explanation(
        "An expected stream is not there",
        "It was not recorded.",
        "Look whether its sensor was switched on, and whether the recorder saw the stream; see "
        "`doctor`.",
    ),
    "expected-empty": Explanation(
        "An expected stream is empty",
        "Its outlet was there and its sensor sent nothing.",
        "Look at the sensor's battery, place and connection; see its page.",
    ),
    "duplicate-source-id": Explanation(
        "One source_id twice",
        "Two programs claim to be one, or a stream was recorded twice; samples may be double.",
        "Compare both streams, and use one of them. Run one agent only for each sensor.",
    ),
    "duplicate-name": Explanation(
        "One name twice",
        "Programs that look for a stream by its name take any of the two.",
        "Tell them apart by their source_id; exports number them.",
    ),
    "not-aligned": Explanation(
        "Streams that cannot be aligned",
        "They come from several computers, and the difference of their clocks was never measured.",
        "Analyse these streams alone, or align them by an event that all of them show. Check "
        "the network by `doctor`.",
    ),
    "replay": Explanation(
        "A replay",
        "These samples were played from an older recording, and not measured then.",
        "Use the recording that was played, unless you want to test something.",
    ),
    "robot-clock": Explanation(
        "The robot's clock is in doubt",
        "Stamps of its topics may be off by what is said.",
        "Set the robot's clock by NTP or chrony, and correct the stamps if you know by how much.",
    ),
    "absent": Explanation(
        "A sensor was never there",
        "It is in the settings and was never connected, so nothing of it was recorded.",
        "Nothing, if it was not to be used; else see the sensor's page.",
    ),
    "left-out": Explanation(
        "The recorder left something out",
        "The agent had the stream, and the recorder did not take it.",
        "Have LabRecorder update its list before you start, or record by `record start`, which "
        "waits until all are there.",
    ),
    "removed": Explanation(
        "A sensor was removed or renamed while it was recorded",
        "From then on it had other streams, which the recorder did not know.",
        "Use what came before; change settings between recordings.",
    ),
    "away": Explanation(
        "A sensor was away for a while",
        "It was paused or not connected, and nothing was measured meanwhile.",
        "Leave that time out of the analysis of this sensor.",
    ),
    "silent": Explanation(
        "A sensor was connected and sent nothing for a while",
        "Its data waited in the device or the radio, or were lost; how many, is counted.",
        "Look at the gaps and counts of its streams; wear it on the side of the receiver.",
    ),
    "clock-jumped": Explanation(
        "Stamps of a sensor jumped",
        "The device's clock was set, or what came first had waited: the stamps just before were "
        "wrong by about the jump.",
        "Compare the seconds before each jump with another sensor, or leave them out.",
    ),
    "refused": Explanation(
        "The agent did not pass on all as it came",
        "Values were kept back, changed or stamped when they arrived; the sentence says which.",
        "Leave these samples out of the analysis, and see to what the sentence names.",
    ),
    "int64": Explanation(
        "An int64 stream",
        "LabRecorder cannot record this format, so there is only its header.",
        "Have its program send int32 or double64, or use the gateway's own recorder.",
    ),
    "refused-header": Explanation(
        "A header that claims to be ours",
        "It does not hold what ours hold, so the stream is treated as another program's.",
        "Look which program sent it, and update it.",
    ),
    "not-utf8": Explanation(
        "Letters are guessed",
        "The program wrote accents and the like in an encoding of its own. They are read as "
        "Windows writes them in Western Europe, which may be wrong; numbers and times are right.",
        "Compare such texts with what the program was to send, and have it send UTF-8.",
    ),
    "no-source-id": Explanation(
        "No source_id",
        "If its program restarts, the recorder takes it for another stream and records it no "
        "further.",
        "Have the program set a source_id; start it before the recording.",
    ),
    "wrong-clock": Explanation(
        "Stamps of another clock",
        "Nothing says when these samples were against the other streams.",
        "Analyse the stream alone, or align it by an event that both show. Its program should "
        "stamp with LSL's clock, or not at all.",
    ),
    "bad-stamps": Explanation(
        "Stamps that are no numbers",
        "Nothing says when these samples were; exports leave them out.",
        "Tell the author of the sending program.",
    ),
    "stray-stamps": Explanation(
        "Single stamps far away",
        "Single samples have a stamp of another time; the samples are right, as far as one sees. "
        "At the very end it is what an outlet leaves behind that goes while it is recorded.",
        "Leave these samples out; `xdf salvage` takes away those at the end.",
    ),
    "backwards": Explanation(
        "Time runs backwards",
        "The clock was set or the program started again, so samples may be double or out of order.",
        "Look at the places; each begins a run of its own in EDF and Kubios.",
    ),
    "bursts": Explanation(
        "Stamped in bursts",
        "The program gives many samples the time at which they arrived. Nothing is lost, and the "
        "times of single samples are not known better than the length of a burst.",
        "Use the rate that is said, as the exports to EDF, Kubios and BIDS do; have the loader of "
        "your analysis smooth stamps (pyxdf does by default).",
    ),
    "overlaps": Explanation(
        "Stamped when it came",
        "Packets came late now and then, so that stamps overlap. Nothing is lost.",
        "Use the rate that is said, as the exports to EDF, Kubios and BIDS do; have the loader of "
        "your analysis smooth stamps (pyxdf does by default).",
    ),
    "gaps": Explanation(
        "Gaps",
        "Samples were lost on the way, mostly on the radio; nothing was filled in.",
        "Leave the gaps out of the analysis. Wear the sensor on the side of the receiver, and "
        "keep other radios away.",
    ),
    "smeared-gaps": Explanation(
        "Gaps that loaders smear",
        "The header does not say that samples may be missing, so pyxdf and MATLAB's loader "
        "spread short gaps over the whole recording.",
        "Load it with `dejitter_timestamps=False`, or use an export of this program.",
    ),
    "held-up": Explanation(
        "The computer was held up",
        "The agent's reports came late. Streams that are stamped on arrival, such as a heart "
        "rate, may be stamped so much too late.",
        "Close other programs while you record; see `doctor`.",
    ),
    "rate": Explanation(
        "Another rate than the header says",
        "Analyses that take the rate of the header get wrong times and frequencies.",
        "Take the rate that was measured; exports do.",
    ),
    "no-offsets": Explanation(
        "Clock offsets were not measured",
        "Of a stream of the recording computer nothing is wrong by that; one of another "
        "computer cannot be aligned.",
        "Record for ten seconds at least; let LSL's ports through the firewall.",
    ),
    "offset-scatter": Explanation(
        "Clock offsets scatter",
        "Times of streams of other computers are less exact than usual, by about what is said.",
        "Use a cable in place of WLAN, or a network of its own.",
    ),
    "clock-reset": Explanation(
        "The sender's clock began again",
        "Its computer or its clock was set or restarted; times are right on both sides of that "
        "moment, and around it nobody knows them.",
        "Look at what happened then, and treat it as a gap.",
    ),
    "drift": Explanation(
        "A clock drifts",
        "One of the computers has a bad clock, or it was corrected meanwhile. Times are "
        "corrected by the measured offsets.",
        "Nothing, if it is below 1000 ppm; else synchronise the computers' clocks.",
    ),
    "begins-late": Explanation(
        "Begins late",
        "Nothing was measured of it in the first seconds.",
        "Begin the analysis later; start recordings when all sensors stream.",
    ),
    "ends-early": Explanation(
        "Ends early",
        "Nothing was measured of it in the last seconds: the battery, the radio or its program.",
        "End the analysis earlier; look at the sensor's battery.",
    ),
    "no-values": Explanation(
        "A channel without any value",
        "The device does not measure it, or had no contact.",
        "Leave the channel out.",
    ),
    "nan": Explanation(
        "Samples without a value",
        "The device said that it could not measure then, mostly for want of contact.",
        "Treat them as missing; nothing was filled in.",
    ),
    "not-recorded": Explanation(
        "Pushed and not recorded",
        "The agent sent samples that the recorder did not write.",
        "Treat it as a gap of that many samples; keep the recording computer free of other work, "
        "and wait a second before you stop.",
    ),
    "too-many": Explanation(
        "More samples than were sent",
        "Two agents ran, or samples are doubled.",
        "Look for equal stamps; run one agent only for each sensor.",
    ),
    "lost": Explanation(
        "Lost between device and agent",
        "The device numbered samples that never arrived, mostly on the radio.",
        "Leave the gaps out of the analysis. Wear the sensor on the side of the receiver.",
    ),
    "restarted": Explanation(
        "The agent began again",
        "Between its end and its begin nothing was measured.",
        "Treat it as a gap, and see its log for the reason.",
    ),
    "off": Explanation(
        "Switched off",
        "The settings or the device's model leave this stream out.",
        "Nothing, if you do not need it; else switch it on in the settings.",
    ),
    "counters": Explanation(
        "The agent's counts cannot be read",
        "What was recorded cannot be compared with what was sent.",
        "Tell us, with the file's version of the agent.",
    ),
    "no-counters": Explanation(
        "The agent's counts were not recorded",
        "Whether samples are missing is known from their stamps alone.",
        "Record `gateway/counters`, too.",
    ),
    "told": Explanation(
        "What the recorder says",
        "It happened while this was recorded.",
        "Read the sentence; note it with the session.",
    ),
    "ended": Explanation(
        "The recorder has ended",
        "From then on nothing was recorded.",
        "Start another recording at once; this one can be used, or salvaged.",
    ),
    "unreadable": Explanation(
        "The file cannot be read now",
        "Another program holds it, or the disk is away.",
        "Look at the disk and the folder.",
    ),
    "no-agent": Explanation(
        "No agent",
        "No sensor of this program is recorded.",
        "Start the agent, unless you record other programs only.",
    ),
    "little-space": Explanation(
        "Little space on the disk",
        "The recording ends when it is full.",
        "Make room while it goes on.",
    ),
    "still": Explanation(
        "The file does not grow",
        "Nothing is being written.",
        "Look at recorder and disk; start another recording if it stays so.",
    ),
    "stopped": Explanation(
        "A stream has stopped",
        "Others go on and nothing comes of it.",
        "Look at its sensor.",
    ),
}
"""By the codes of findings, in the order of the page that is made of it."""
