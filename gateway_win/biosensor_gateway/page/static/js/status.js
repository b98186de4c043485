// What every page of the program says of the agent, and which traces it asks for.

import { html, useEffect } from "../vendor/preact-htm.js";
import { mainStreams } from "./cards.js";
import { featuresOf, shownFeatures } from "./features.js";
import { Refused } from "./refusals.js";
import { streamsOf } from "./words.js";

const WINDOW_S = 10;
const SPARK_PIXELS = 300;
const PLOT_PIXELS = 900;
const MOST_REFUSED = 10;
// The server answers no more.
const MOST_ASKED = 200;

const AGENT = {
  running: ["●", "good", "the agent runs"],
  starting: ["◌", "warn", "agent is starting"],
  absent: ["■", "bad", "agent does not run"],
};

// Before the first sensor is set up, nothing is wrong with that.
const NOT_YET = ["○", "soft", AGENT.absent[2]];

export function Agent({ status }) {
  const isNew = status?.agent === "absent" && !status.configured;
  const [sign, tone, word] = isNew ? NOT_YET : status ? AGENT[status.agent] : ["■", "bad", "the page's program does not answer"];
  return html`<span class="state ${tone}" role="status"><span aria-hidden="true">${sign}</span> ${word}</span>`;
}

export function Notices({ status }) {
  return html`
    ${status.problem && html`<section class="panel problem" role="alert"><h2>The settings file has a mistake</h2><p>${status.problem}</p><p class="small soft">Until it is fixed, the agent continues with the previous settings.</p></section>`}
    ${status.virtual && html`<p class="panel notice">These are virtual sensors: their signals are synthetic or recorded.</p>`}
    ${status.restarts > 0 && html`<p class="panel notice">The agent had died (${status.last_end}) and was restarted. The time in between is a gap in every stream.</p>`}
    ${status.refusals.some((each) => each.now) && html`<section class="panel amber"><h2>Some data is not passed on unchanged</h2><${Refused} refusals=${status.refusals} most=${MOST_REFUSED} /></section>`}
    ${status.skipped > 0 && html`<p class="panel notice small">This page was too slow for ${status.skipped} samples and left them out of its traces. They are in streams and recordings.</p>`}`;
}

// Cards of what is played look like those of sensors, but for the mark.
function replayed(replay) {
  return (replay?.devices ?? []).map((each) => ({ ...each, replay: replay.file }));
}

// Has the server send what is on the screen: the main streams of all devices, or all of the one that is open.
export function useShown(live, status, open) {
  const devices = [...(status?.devices ?? []), ...replayed(status?.replay)];
  const device = devices.find((each) => each.name === open);
  useEffect(() => {
    if (!live.current || !status) return;
    const shown = device
      ? [...streamsOf(device), ...featuresOf(device)]
      : [...devices.flatMap(mainStreams), ...devices.flatMap(shownFeatures)];
    live.current.show(shown.map((each) => each.source_id).slice(0, MOST_ASKED), WINDOW_S, device ? PLOT_PIXELS : SPARK_PIXELS);
  }, [status]);
  return { devices, device };
}
