"""The rules that check one stream."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from biosensor_common.quantities import ContentType, Unit
from biosensor_gateway.recording.participants import listed
from biosensor_gateway.recording.xdf.counters import STRANGE_SAMPLES
from biosensor_gateway.recording.xdf.event_rules import Absence, Spell
from biosensor_gateway.recording.xdf.figures import seconds_text
from biosensor_gateway.recording.xdf.findings import About, Finding, Level
from biosensor_gateway.recording.xdf.pace import MOST_LOST, Pace
from biosensor_gateway.recording.xdf.rate_changes import MOST_CHANGES, SMALL_CHANGE
from biosensor_gateway.recording.xdf.recording import repeated_text
from biosensor_gateway.recording.xdf.report import LATE_S, Extent, Measured, last_asked
from biosensor_gateway.recording.xdf.samples import flat_text
from biosensor_gateway.recording.xdf.sender_clock import (
    ASKED_EVERY_S,
    SenderClock,
    Silence,
    is_plausible,
)

Verdict = tuple[Level, str, str]
"""Level, code and text of a finding."""

# The recorder takes the first offset after 5 s.
OFFSETS_DUE_S = 6.0
_MOST_SPANS = _MOST_NAMED = 3
# Relative errors that loaders complain about, and that no computer's oscillator explains.
WRONG_RATE, ODD_RATE = 0.1, 0.01
# The chips of motion and light sensors count by oscillators of their own, which are this much off.
_CHIP_RATE = 0.03
MIN_SAMPLES_FOR_RATE = 20
# If fewer samples are expected, all may fall before the start or after the end.
FEWEST_DUE = 3
# In a good network offsets scatter less, and oscillators drift less.
MAX_SCATTER_S, MAX_DRIFT_PPM, MIN_OFFSETS_FOR_DRIFT = 0.01, 500.0, 5
NAN_SHARE_TO_NOTE = 0.05
# The agent reports once a second. Streams without a device clock are up to a second late anyway.
HELD_UP_S = 2.0
# Sensors count several breaths before they tell how often somebody breathes, and optical ones look
# at beats for 25 s before they tell those and whether the wearer moves.
_FIRST_S = 45.0
_FIRST_TAKES_LONG = frozenset({ContentType.RESPIRATION_RATE, ContentType.QUALITY})
_QUALIFIES = frozenset({Unit.BOOLEAN.value, Unit.FRACTION.value})
# Shorter gaps are smoothed as jitter by default in pyxdf and in the loader for MATLAB.
_LOADER_BREAK_S, _LOADER_BREAK_SAMPLES = 1.0, 500


def judge_stream(measured: Measured, extent: Extent) -> Iterator[Finding]:
    """Apply every rule to one stream."""
    if not measured.stream.header.is_recordable and not measured.stream.sample_count:
        text = "LabRecorder does not record int64 streams: only its header is in the file"
        yield Finding(Level.ERROR, "int64", measured.name, text)
        return
    for rule in _RULES:
        for level, code, text in rule(measured, extent):
            yield Finding(level, code, measured.name, text)


def absent_senders(
    streams: Sequence[Measured], extent: Extent, away: Sequence[Absence] = ()
) -> list[Absence]:
    """Return when programs gave the recorder no answer.

    Streams of one computer that were away at the same time are one event. Where streams have a
    rate, their gaps are consequences of it; of others no sample shows that something is missing.
    """
    end_s = last_asked(each.stream.clock_offsets for each in streams)
    silences = {id(each): each.stream.silences(end_s) for each in streams}
    events: list[tuple[Silence, list[Measured]]] = []
    for each in streams:
        # A recorder gives up a stream that nothing tells from another one, which is told.
        for silence in silences[id(each)] if each.stream.header.source_id else ():
            event = next((own for at, own in events if _is_one(at, silence, own[0], each)), None)
            if event is None:
                events.append((silence, [each]))
            else:
                event.append(each)
    found: list[Absence] = []
    for silence, own in sorted(events, key=lambda event: event[0]):
        host = own[0].stream.header.hostname
        beside = [each for each in streams if each.stream.header.hostname == host != ""]
        # If others of its computer answered, the network was there, and a program had ended.
        is_ended = any(
            each.figures.offsets.count
            and not any(_overlap(silence, at) for at in silences[id(each)])
            for each in beside
        )
        names = list(dict.fromkeys(each.name for each in own))
        if len(names) > _MOST_NAMED and len(own) == len(beside):
            names = [f"all {len(own)} streams of {host}"]
        finding = _no_answer(silence, own, names, is_ended, extent)
        causes = [each.finding.text for each in away if _explains(each, silence, own)]
        until_s = None if silence.until_s == math.inf else own[0].own_s(silence.until_s)
        # Before its program ends, a stream may come to rest.
        spell = Spell("away", own[0].own_s(silence.since_s - ASKED_EVERY_S), until_s)
        ids = frozenset(each.stream.header.source_id for each in own)
        part_of = causes[0] if causes else ""
        found.append(Absence(replace(finding, part_of=part_of), None, host, (spell,), ids))
    return found


def _is_one(one: Silence, other: Silence, *streams: Measured) -> bool:
    """Whether two streams were away at the same time, as the recorder asks every few seconds."""
    is_one_host = len({each.stream.header.hostname for each in streams}) == 1
    return is_one_host and all(
        a == b or abs(a - b) < 2 * LATE_S for a, b in zip(one, other, strict=True)
    )


def _no_answer(
    silence: Silence, own: Sequence[Measured], names: list[str], is_ended: bool, extent: Extent
) -> Finding:
    since = f"from {max(0.0, silence.since_s - extent.begin):.1f} s"
    is_last = silence.until_s == math.inf
    until = "to the end" if is_last else f"to {silence.until_s - extent.begin:.1f} s"
    # Whoever answers again may only have stood still, as its computer did.
    why = "the program had ended" if is_last else "the program had ended or stood still"
    why += "" if is_ended else " or its network was away"
    missing = "is" if is_last else "may be"
    text = f"no answer {since} {until}: {why}, so what it would have sent then {missing} missing"
    is_single = len(own) == 1
    # An experiment often ends before the recording, and sends nothing between two runs.
    is_usual = is_ended and all(
        each.stream.header.content_type == ContentType.MARKERS for each in own
    )
    return Finding(
        Level.NOTE if is_usual else Level.WARNING,
        "no-answer",
        names[0] if is_single else "",
        text if is_single else f"{listed(names)}: {text}",
        About.PERSONS if any(each.stream.header.is_ours for each in own) else About.OTHERS,
    )


def _overlap(one: Silence, other: Silence) -> bool:
    return one.since_s < other.until_s and other.since_s < one.until_s


def _explains(absence: Absence, silence: Silence, own: Sequence[Measured]) -> bool:
    """Whether the agent was away in this time, and with it all these streams."""
    if absence.device is not None or not all(absence.concerns(e.stream.header) for e in own):
        return False
    spells = [
        Silence(
            -math.inf if spell.since is None else own[0].recorder_s(spell.since),
            math.inf if spell.until is None else own[0].recorder_s(spell.until),
        )
        for spell in absence.spells
    ]
    return any(_overlap(silence, each) for each in spells)


def _identity(measured: Measured, _extent: Extent) -> Iterator[Verdict]:
    header = measured.stream.header
    if header.is_guessed:
        text = "its header is not UTF-8, so its characters are guessed from Windows' encoding"
        yield Level.WARNING, "not-utf8", text
    if guessed := measured.stream.guessed_texts:
        texts = "1 of its texts is" if guessed == 1 else f"{guessed} of its texts are"
        text = f"{texts} not UTF-8, so characters are guessed from Windows' encoding"
        yield Level.WARNING, "not-utf8", text
    if header.refused:
        yield Level.WARNING, "refused-header", f"it claims to be ours, but {header.refused}"
    if not header.source_id:
        text = "it has no source_id, so its recording ends when its program restarts"
        yield Level.WARNING, "no-source-id", text


def _footer(measured: Measured, _extent: Extent) -> Iterator[Verdict]:
    held, footer = measured.stream.sample_count, measured.stream.footer
    written = held + measured.stream.repeated
    if footer is None and not measured.stream.header.source_id:
        text = "it has no footer: its program ended before the recording did"
        yield Level.WARNING, "no-footer", text
    elif footer is None:
        text = "it has no footer: the recorder did not close it, so its end may be missing"
        yield Level.ERROR, "no-footer", text
    elif footer.sample_count is None:
        yield Level.WARNING, "footer-count", "its footer does not say how many samples there are"
    elif held and footer.sample_count == held - 1 and _ends_astray(measured):
        text = (
            "its footer counts one sample less: the last one is invalid, as its outlet had closed"
        )
        yield Level.NOTE, "footer-count", text
    elif held and footer.sample_count == held - 1:
        text = "its footer counts one sample less: older LabRecorders do not count the first"
        yield Level.NOTE, "footer-count", text
    elif footer.sample_count not in {held, written}:
        text = f"its footer counts {footer.sample_count} samples, the file holds {held}"
        yield Level.ERROR, "footer-count", text


def _ends_astray(measured: Measured) -> bool:
    pace = measured.figures.pace
    return pace is not None and pace.ends_astray


def _samples(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    header = measured.stream.header
    if measured.stream.sample_count:
        return
    if measured.counters is not None and measured.counters.is_off:
        text = "it is switched off in the settings, or this model of the device has no such data"
        yield Level.NOTE, "off", text
    elif header.is_regular and 0 < extent.length_s * header.rate < FEWEST_DUE:
        text = f"it has no samples: {extent.length_s:.1f} s are too short for {header.rate:g} Hz"
        yield Level.WARNING, "no-samples", text
    elif header.is_regular:
        text = f"it should have {header.rate:g} samples per second and has none"
        yield Level.ERROR, "no-samples", text
    elif header.content_type == "Markers":
        text = "it has no markers, which makes some versions of MATLAB's loader fail"
        yield Level.NOTE, "no-samples", text
    else:
        yield Level.NOTE, "no-samples", "it has no samples"


def _stamps(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    figures = measured.figures
    if figures.clock_error:
        yield Level.ERROR, "wrong-clock", figures.clock_error
    if figures.part_error:
        yield Level.ERROR, "wrong-clock", figures.part_error
    if measured.stream.repeated:
        yield Level.WARNING, "repeated", repeated_text(measured.stream.repeated)
    if figures.bad_stamps:
        yield Level.ERROR, "bad-stamps", f"{figures.bad_stamps} of its timestamps are not numbers"
    if figures.pace is not None and figures.pace.stray:
        count = len(figures.pace.stray)
        stamps = "1 stamp is" if count == 1 else f"{count} stamps are"
        text = f"{stamps} far from those of the samples before and after"
        yield Level.ERROR, "stray-stamps", text
    if figures.pace is not None:
        yield from _late_or_still(figures.pace, measured, extent)
    if figures.backward_steps:
        yield _backwards(measured)


def _late_or_still(pace: Pace, measured: Measured, extent: Extent) -> Iterator[Verdict]:
    if pace.late_first:
        samples = "sample is" if pace.late_first == 1 else f"{pace.late_first} samples are"
        text = (
            f"its first {samples} stamped up to {seconds_text(pace.late_first_s, 3)} late, as when "
            "a sender begins, or samples are there twice"
        )
        yield Level.WARNING, "late-first", text
    if pace.standstills:
        count = sum(each.count for each in pace.standstills)
        places = len(pace.standstills)
        often = "" if places == 1 else f" in {places} places,"
        at = extent.since_begin(pace.standstills[0].stamp_s, measured)
        text = (
            f"its timestamps stand still{often} from {seconds_text(at, 1)} on, for {count} "
            f"samples, which take {count * pace.period_s:.3g} s"
        )
        yield Level.ERROR, "standstill", text


def _backwards(measured: Measured) -> Verdict:
    header, figures = measured.stream.header, measured.figures
    one = figures.backward_steps == 1
    places = "1 place, by" if one else f"{figures.backward_steps} places, by up to"
    rate_hz = figures.rate_between_gaps_hz
    # The next sample would have been due a period later.
    back_s = figures.furthest_back_s + (0.0 if rate_hz is None else 1 / rate_hz)
    text = f"its timestamps run backwards in {places} {seconds_text(back_s, 3)}"
    if rate_hz is not None:
        samples = round(min(back_s * rate_hz, MOST_LOST))
        about = "" if figures.pace is None or figures.pace.spread_s * rate_hz < 0.1 else "about "
        # Stamps alone do not tell one from the other.
        is_possible = samples <= measured.stream.sample_count // 2
        are = "1 sample is" if samples == 1 else f"{samples} samples are"
        most = "" if one else "up to "
        text += f": {most}{about}{are} duplicated, or" if is_possible else ":"
        text += " its sender's clock was set back"
        return Level.ERROR, "backwards", text
    # Who stamps what is to be or has been stamps in another order than it sends.
    return Level.ERROR if header.is_ours else Level.WARNING, "backwards", text


def _bursts(measured: Measured, _extent: Extent) -> Iterator[Verdict]:
    """Report timestamps of another program that a loader may mistake for gaps or steps back."""
    pace = measured.figures.pace
    if pace is None:
        return
    lost = "nothing seems lost" if not pace.holes else "other samples are lost"
    rate = f"{1 / pace.period_s:.4g} Hz; {lost}"
    if pace.burst > 1:
        every_s = pace.burst * pace.period_s
        text = f"timestamps in bursts of {pace.burst}, each {every_s:.2g} s; {rate}"
        yield Level.NOTE, "bursts", text
    elif pace.overlap_s > 0:
        overlap = f"its stamps overlap by up to {pace.overlap_s * 1e3:.3g} ms"
        text = f"timestamps are arrival times, so {overlap}; {rate}"
        yield Level.NOTE, "overlaps", text


def _gaps(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    header, gaps = measured.stream.header, measured.figures.gaps
    if pauses := measured.figures.pauses.count:
        times = "1 pause" if pauses == 1 else f"{pauses} pauses"
        text = f"{times} of {measured.figures.pauses.total_s:.3g} s in total; nothing is lost"
        yield Level.NOTE, "paused", text
    if not gaps.count:
        return
    worst = max(gaps.listed, key=lambda gap: gap.length_s)
    at = extent.since_begin(worst.after, measured)
    if header.is_counters:
        yield _held_up(worst.length_s, at)
        return
    places = "1 gap" if gaps.count == 1 else f"{gaps.count} gaps"
    text = (
        f"{places} of {gaps.total_s:.3g} s in total, about {gaps.lost} samples lost; the longest "
        f"of {worst.length_s:.3g} s at {seconds_text(at, 1)}"
    )
    yield Level.WARNING, "gaps", text
    period_s = 1 / header.rate if header.is_regular else 0.0
    smeared_up_to = max(_LOADER_BREAK_S, _LOADER_BREAK_SAMPLES * period_s)
    # Loaders leave stamps of a stream without a rate alone.
    is_smeared = header.is_regular and not header.can_drop_samples
    if is_smeared and any(g.length_s <= smeared_up_to for g in gaps.listed):
        text = (
            "its header does not state can_drop_samples, so load it with "
            "dejitter_timestamps=False, otherwise the gaps shift its timestamps"
        )
        yield Level.WARNING, "smeared-gaps", text


def _held_up(length_s: float, at: float) -> Verdict:
    """Report that the agent's reports were late; its counts are cumulative, so nothing is lost."""
    text = (
        f"the agent's counts came {length_s:.2g} s apart at {seconds_text(at, 1)}, as on a busy "
        "computer"
    )
    if length_s < HELD_UP_S:
        return Level.NOTE, "held-up", f"{text}; nothing is missing"
    late = (
        "streams without a clock, such as a heart rate, may have timestamps that are late by as "
        "much"
    )
    return Level.WARNING, "held-up", f"{text}; {late}"


def _rate(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    figures, nominal = measured.figures, measured.stream.header.rate
    if figures.rate_changes:
        yield from _rate_changes(measured, extent)
        return
    rate = figures.rate_between_gaps_hz
    if figures.found_hz is not None:
        text = (
            f"its header names no rate, but its samples come evenly, at {figures.found_hz:.4g} "
            "Hz; EDF, Kubios, BIDS and features use that"
        )
        yield Level.NOTE, "no-rate", text
        return
    too_few = measured.stream.sample_count < MIN_SAMPLES_FOR_RATE
    # A late report is followed by one on time, which makes the rate look wrong.
    is_told = measured.stream.header.is_counters
    if rate is None or too_few or figures.backward_steps or is_told:
        return
    error = abs(rate / nominal - 1)
    if error > ODD_RATE:
        is_chip = measured.stream.header.is_ours and error <= _CHIP_RATE
        level = Level.ERROR if error > WRONG_RATE else Level.NOTE if is_chip else Level.WARNING
        yield level, "rate", f"it runs at {rate:.4g} Hz instead of {nominal:.4g} Hz"


def _bend(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    bend = measured.figures.bend
    if bend is None:
        return
    at = extent.since_begin(bend.stamp_s, measured)
    text = (
        "its rate is not constant: a straight line through its timestamps is off by up to "
        f"{seconds_text(bend.away_s, 3)} (at {seconds_text(at, 1)}), and so are EDF, Kubios, BIDS "
        "and loaders that make timestamps even"
    )
    yield Level.WARNING, "bent", text


def _rate_changes(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    changes = measured.figures.rate_changes
    if len(changes) > MOST_CHANGES:
        text = f"its rate changes {len(changes)} times, so its header's rate is of no use"
        yield Level.ERROR, "rate-change", text
        return
    for each in changes:
        at = extent.since_begin(each.stamp_s, measured)
        text = (
            f"from {seconds_text(at, 1)} on it runs at {each.after_hz:.4g} Hz, before at "
            f"{each.before_hz:.4g} Hz: its sender got other settings, or samples are missing evenly"
        )
        is_small = abs(math.log(each.after_hz / each.before_hz)) < SMALL_CHANGE
        yield Level.WARNING if is_small else Level.ERROR, "rate-change", text


def _offsets(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    offsets = measured.figures.offsets
    if not offsets.count:
        if max(measured.figures.span_s, extent.length_s) < OFFSETS_DUE_S:
            text = "no clock offsets, because the recording is too short"
            yield Level.NOTE, "no-offsets", text
        else:
            text = "no clock offsets, so it cannot be aligned with streams of other computers"
            yield Level.WARNING, "no-offsets", text
        return
    if offsets.resets:
        times = "once" if offsets.resets == 1 else f"{offsets.resets} times"
        spans = SenderClock(measured.stream.clock_offsets).doubtful_spans
        told = "; ".join(each.text(extent.begin) for each in spans[:_MOST_SPANS])
        text = f"its sender's clock was restarted or set {times}; "
        text += (
            told or "its timestamps show which samples came before and after, so times are right"
        )
        yield Level.WARNING, "clock-reset", text
    if unused := SenderClock(measured.stream.clock_offsets).unused:
        # The last one alone is that of an outlet that was closing, and no sample comes after it.
        is_used = is_plausible(np.array(measured.stream.clock_offsets))
        is_only_last = len(is_used) > 1 and bool(is_used[:-1].all())
        level = Level.NOTE if is_only_last else Level.WARNING
        yield level, "unused-offsets", unused
    if offsets.scatter_s is not None and offsets.scatter_s > MAX_SCATTER_S:
        text = f"its clock offsets scatter by {offsets.scatter_s * 1e3:.0f} ms: a slow network"
        yield Level.WARNING, "offset-scatter", text
    drift = offsets.drift_ppm
    if drift is not None and offsets.count >= MIN_OFFSETS_FOR_DRIFT and abs(drift) > MAX_DRIFT_PPM:
        text = f"its clock drifts by {drift:.0f} ppm against the recorder's"
        yield Level.WARNING, "drift", text


def _extent(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    figures = measured.figures
    regular = measured.stream.header.is_regular and not figures.clock_error
    if not regular or figures.first is None or figures.last is None:
        return
    late_s = extent.since_begin(figures.first, measured)
    if late_s > LATE_S:
        yield (
            Level.WARNING,
            "begins-late",
            f"it starts {seconds_text(late_s, 1)} after the recording",
        )
    early_s = extent.length_s - extent.since_begin(figures.last, measured)
    stood = figures.pace.standstills if figures.pace else ()
    stands = bool(stood) and stood[-1].at + stood[-1].count == measured.stream.sample_count
    # A clock that stands still to the end does not tell when the end was.
    if early_s > LATE_S and not stands:
        yield (
            Level.WARNING,
            "ends-early",
            f"it ends {seconds_text(early_s, 1)} before the recording",
        )


def _values(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    header, count = measured.stream.header, measured.stream.sample_count
    if not count:
        return
    shares = list(zip(header.labels, measured.figures.nan_shares, strict=True))
    empty = [
        (label, unit)
        for (label, share), unit in zip(shares, header.units, strict=True)
        if share == 1
    ]
    lacking = measured.counters.lacking if measured.counters is not None else ()
    if off := ", ".join(label for label, _ in empty if label in lacking):
        yield Level.NOTE, "off", f"this device does not send {off}"
        empty = [each for each in empty if each[0] not in lacking]
    window_s = header.window_s
    if window_s is not None:
        # In a feature, these channels tell the quality of others, if anything is known about it.
        unknown = ", ".join(label for label, unit in empty if unit in _QUALIFIES)
        empty = [each for each in empty if each[1] not in _QUALIFIES]
        if unknown:
            yield Level.NOTE, "no-values", f"nothing in the recording determines {unknown}"
    labels = ", ".join(label for label, _ in empty)
    if empty and window_s is not None and extent.length_s < window_s:
        text = f"no value yet in {labels}: they look back over up to {window_s:g} s"
        yield Level.NOTE, "no-values", text
    elif empty and header.content_type in _FIRST_TAKES_LONG and extent.length_s < _FIRST_S:
        text = (
            f"no value yet in {labels}: sensors need several breaths or beats, up to {_FIRST_S:g} s"
        )
        yield Level.NOTE, "no-values", text
    elif empty:
        yield Level.WARNING, "no-values", f"no value at all in {labels}"
    gappy = [f"{label} {s:.0%}" for label, s in shares if NAN_SHARE_TO_NOTE <= s < 1]
    if gappy:
        yield Level.NOTE, "nan", f"share without a value: {', '.join(gappy)}"


def _flat(measured: Measured, _extent: Extent) -> Iterator[Verdict]:
    if flat := measured.stream.constants.found:
        yield Level.WARNING, "flat", flat_text(flat)


def _counted(measured: Measured, extent: Extent) -> Iterator[Verdict]:
    counters = measured.counters
    if counters is None:
        return
    if counters.strange_since is not None:
        text = (
            f"from {extent.since_begin(counters.strange_since, measured):.1f} s on "
            f"{STRANGE_SAMPLES}"
        )
        yield Level.ERROR, "another-agent", text
    if counters.held < counters.pushed:
        missing = counters.pushed - counters.held
        text = f"{missing} of {counters.pushed} samples that the agent pushed are not in the file"
        yield Level.ERROR, "not-recorded", text
    elif counters.held > counters.pushed:
        text = f"{counters.held} samples are in the file, but the agent pushed {counters.pushed}"
        yield Level.ERROR, "too-many", text
    if counters.lost:
        text = f"the agent counted {counters.lost} samples as lost on the way from the device"
        yield Level.WARNING, "lost", text
    if counters.restarts:
        text = f"the agent was restarted {counters.restarts} times during the recording"
        yield Level.WARNING, "restarted", text


_RULES: tuple[Callable[[Measured, Extent], Iterator[Verdict]], ...] = (
    _identity,
    _footer,
    _samples,
    _stamps,
    _bursts,
    _counted,
    _gaps,
    _rate,
    _bend,
    _extent,
    _offsets,
    _values,
    _flat,
)
