"""A web experiment in a real browser: markers say when they happened, and how exactly.

The truth is what Chromium tells its debugger: the time of its own steady clock, which is LSL's on
Linux, at which the page's time was 0. These tests have a lab of their own: those of who may mark
change its settings and end its agent.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S
from tests.page.web_lab import MarkerReader, WebLab
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

expect.set_options(1000 * DEADLINE_S)
OpenWindow = Callable[..., Page]

# A clock that somebody set, or may set while the page is there.
CLOCK = """
window.ahead = %s;
const real = performance.now.bind(performance);
performance.now = () => real() + window.ahead;
"""
HALF_HOUR_MS = 1_800_000
BUSY = """async ([marker, busy]) => {
  const at = performance.now();
  while (performance.now() < at + busy);
  const sent = await markers.mark(marker, { at });
  return [at - (window.ahead ?? 0), sent];
}"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Generator[WebLab]:
    running = WebLab(tmp_path_factory.mktemp("state"))
    yield running
    running.close()


@pytest.fixture(scope="module")
def reader(lab: WebLab) -> MarkerReader:
    return MarkerReader()


def is_ready(page: Page) -> None:
    page.wait_for_function("markers.state === 'ready'")


def experimenter(lab: WebLab, window: OpenWindow) -> Page:
    """Open the gateway's own page."""
    page = window()
    name, _, value = lab.cookie.partition("=")
    page.context.add_cookies([{"name": name, "value": value, "url": lab.server.origin}])
    page.goto(lab.server.origin)
    return page


def zero_of(page: Page) -> float:
    """LSL time, in seconds, at which the page's time was 0."""
    debugger: Any = page.context.new_cdp_session(page)
    debugger.send("Performance.enable")
    told: list[dict[str, Any]] = debugger.send("Performance.getMetrics")["metrics"]
    return {each["name"]: each["value"] for each in told}["NavigationStart"]


def is_right(marker: dict[str, Any], zero: float, at_ms: float) -> None:
    assert marker["timed_by"] == "clock"
    # An uncertainty that nobody can use is none.
    assert marker["uncertainty_s"] < 0.2
    assert abs(marker["lsl_time"] - (zero + at_ms / 1000)) <= marker["uncertainty_s"]


@pytest.mark.parametrize("ahead_ms", [0, 4 * HALF_HOUR_MS, -60 * HALF_HOUR_MS])
def test_a_marker_says_when_it_happened_though_the_page_was_busy_and_its_clock_is_off(
    lab: WebLab, reader: MarkerReader, window: OpenWindow, ahead_ms: float
) -> None:
    page = window()
    page.add_init_script(CLOCK % ahead_ms)
    page.goto(lab.experiment())
    is_ready(page)
    zero = zero_of(page)
    for busy_ms in (0, 300):
        name = f"{ahead_ms} {busy_ms}"
        at_ms, answer = page.evaluate(BUSY, [name, busy_ms])
        sent = reader.find(name)
        is_right(sent, zero, at_ms)
        assert (sent["kind"], sent["source"]) == ("web", lab.origin)
        # No marker is before it in the stream, so its stamp is the same.
        assert sent["stamp"] == pytest.approx(sent["lsl_time"], abs=1e-5)
        assert answer == {key: sent[key] for key in ("id", "lsl_time", "timed_by", "uncertainty_s")}


def test_a_clock_that_is_set_meanwhile_is_measured_again(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    page = window()
    page.add_init_script(CLOCK % 0)
    page.goto(lab.experiment())
    is_ready(page)
    zero = zero_of(page)
    page.evaluate(f"window.ahead = {HALF_HOUR_MS}")
    # It would be in the future, if it were not for the clock.
    at_ms, _ = page.evaluate(BUSY, ["set ahead", 0])
    is_right(reader.find("set ahead"), zero, at_ms)
    # Back again: only the next questions show it, so markers are of half an hour ago until then.
    page.evaluate("window.ahead = 0")
    marks = [page.evaluate(BUSY, ["set back", 0])]
    wait_until(
        lambda: (
            marks.append(page.evaluate(BUSY, ["set back", 0]))
            or abs(marks[-1][1]["lsl_time"] - zero - marks[-1][0] / 1000) < 1000
        )
    )
    is_right(marks[-1][1], zero, marks[-1][0])


def test_markers_wait_while_the_program_is_away_and_are_marked_once(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    page = window()
    page.goto(lab.experiment())
    is_ready(page)
    zero = zero_of(page)
    lab.server.process.send_signal(signal.SIGINT)
    assert lab.server.process.wait(DEADLINE_S) == 0
    page.wait_for_function("markers.state === 'away'")
    page.evaluate("""() => {
      window.kept = [];
      for (let n = 0; n < 60; n++) {
        const at = performance.now();
        window.kept.push(markers.mark("kept", { note: String(n), at }).then((sent) => [at, sent]));
      }
    }""")
    lab.serve()
    kept: list[Any] = page.evaluate("Promise.all(window.kept)")
    page.evaluate("markers.mark('behind them')")
    reader.find("behind them")
    found = reader.named("kept")
    assert [each["note"] for each in found] == [str(number) for number in range(60)]
    for each, (at_ms, sent) in zip(found, kept, strict=True):
        assert each["id"] == sent["id"]
        is_right(each, zero, at_ms)


def test_a_wrong_token_is_said_and_marks_nothing(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    page = window()
    page.goto(lab.experiment(token="wrong"))
    status = page.get_by_role("status")
    expect(status).to_contain_text("Refused: the token is wrong; biosensor-gateway mark --web")
    assert page.evaluate("markers.mark('smuggled').catch((error) => error.message)") == (
        "the token is wrong; biosensor-gateway mark --web shows the right one"
    )
    expect(page.get_by_role("button", name="Start")).to_be_disabled()


POST = """([address, token]) => fetch(`${address}/api/v1/markers`, {
  method: "POST",
  headers: { "Authorization": `Bearer ${token}`, "Content-Type": "application/json" },
  body: JSON.stringify({ marker: "posted", age_ms: 500 }),
}).then((answer) => answer.json(), (error) => error.name)"""


def test_a_page_of_another_origin_marks_nothing_and_the_experimenter_learns_of_it(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    page, address = window(), lab.address.replace("ws:", "http:")
    page.goto(lab.experiment(lab.other))
    said = f"is {lab.other.origin} one of its origins?"
    expect(page.get_by_role("status")).to_contain_text(said)
    assert page.evaluate(POST, [address, lab.token]) == "TypeError"
    # Without a question before it, as a form could: the browser sends it, and it is refused.
    page.evaluate(
        "address => fetch(address + '/api/v1/markers', {method: 'POST', mode: 'no-cors', "
        "body: JSON.stringify({marker: 'posted'})}).catch(() => 0)",
        address,
    )
    mine = experimenter(lab, window)
    region = mine.get_by_role("region", name="Markers")
    expect(region.get_by_text(f"Refused: a page of {lab.other.origin}")).to_be_visible()

    page.goto(lab.experiment())
    answer = page.evaluate(POST, [address, lab.token])
    sent = reader.find("posted")
    assert len(reader.named("posted")) == 1
    assert reader.named("smuggled") == []
    assert (sent["timed_by"], "uncertainty_s" in sent) == ("age", False)
    assert answer["id"] == sent["id"]


def test_a_page_from_a_file_marks_where_that_is_allowed(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    page = window()
    page.goto(f"{(lab.files / 'experiment.html').as_uri()}{lab.key}")
    is_ready(page)
    page.evaluate("markers.mark('from a file')")
    assert reader.find("from a file")["source"] == "null"


@pytest.mark.seam
def test_the_example_is_run_by_a_participant(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    page = window(color_scheme="dark", viewport={"width": 400, "height": 700})
    page.goto(lab.experiment())
    expect(page.get_by_role("status")).to_contain_text("Connected")
    assert violations(page) == []
    page.emulate_media(color_scheme="light")
    assert violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    count = len(reader.named("key"))
    page.get_by_role("button", name="Start").press("Enter")
    for trial in range(1, 6):
        expect(page.get_by_role("img", name="circle")).to_be_visible()
        # This participant would be faster than the frame in which the circle is shown.
        reader.wait_for("circle on", f"trial {trial}")
        page.keyboard.press("Space")
        expect(page.get_by_role("img", name="circle")).to_be_hidden()
    expect(page.get_by_text("Done. Thank you.")).to_be_visible()
    assert violations(page) == []
    wait_until(
        lambda: bool(reader.find("experiment end")) and len(reader.named("key")) == count + 5
    )
    shown, pressed = reader.named("circle on")[-5:], reader.named("key")[-5:]
    assert [each["note"] for each in pressed] == [f"trial {number}" for number in range(1, 6)]
    for on, key in zip(shown, pressed, strict=True):
        assert on["lsl_time"] < key["lsl_time"]


def test_the_experimenter_sees_web_markers_and_undoes_one(
    lab: WebLab, reader: MarkerReader, window: OpenWindow
) -> None:
    experiment, mine = window(), experimenter(lab, window)
    experiment.goto(lab.experiment())
    is_ready(experiment)
    region = mine.get_by_role("region", name="Markers")
    expect(
        region.get_by_text(f"connected: {lab.origin}, its clock is known, to within")
    ).to_be_visible()
    number = experiment.evaluate("markers.mark('wrong <b>one</b>').then((sent) => sent.id)")
    line = region.locator("li", has_text="wrong <b>one</b>")
    expect(line).to_contain_text(f"from {lab.origin}, to within")
    assert violations(mine) == []
    line.get_by_role("button", name="undo").click()
    expect(line).to_contain_text("marked as a mistake")
    assert reader.find("undo")["of"] == number
    assert f"wrong <b>one</b>, from {lab.origin} (undone)" in lab.programs.call("mark", "--list")
