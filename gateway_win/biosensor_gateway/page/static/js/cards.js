// The overview: a card for each device, grouped by who wears it.

import { html } from "../vendor/preact-htm.js";
import { Features, marksOf } from "./features.js";
import { Refused } from "./refusals.js";
import { Spark } from "./spark.js";
import { momentOf, rateOf, refusalsOf, stateOf, streamsOf, valueOf } from "./words.js";

const SHOWN = 4;

// What a person looks at first: what was measured on the body, the fastest first.
export function mainStreams(device) {
  return streamsOf(device)
    .filter((each) => each.is_signal && !each.derived_from && each.channels.length && each.units[0] !== "boolean" && !each.silent && !each.is_empty)
    .sort((a, b) => b.nominal_hz - a.nominal_hz)
    .slice(0, SHOWN);
}

export function State({ device }) {
  const { sign, tone, word } = stateOf(device);
  return html`<span class="state ${tone}"><span aria-hidden="true">${sign}</span> ${word}${device.since && html` <span class="small since">since ${momentOf(device.since)}</span>`}</span>`;
}

function Card({ live, device, onOpen }) {
  const battery = device.battery_percent;
  return html`
    <li class="card ${device.replay ? "replay" : ""}" data-device=${device.name}>
      <div class="card-head">
        <h3>${device.title} <span class="soft small">${device.label || device.unit}</span></h3>
        <${State} device=${device} />
      </div>
      <div class="sparks">
        ${mainStreams(device).map((stream) => html`
          <span class="small">${stream.data_name}${stream.channels.length > 1 && html` <span class="soft">${stream.channels[0]}</span>`}</span>
          <${Spark} live=${live} stream=${stream} marks=${marksOf(device, stream)} />
          <span class="value small" title=${rateOf(stream)}>${valueOf(stream)}</span>`)}
      </div>
      <${Features} live=${live} device=${device} />
      ${device.error && html`<p class="reason small">${device.error}</p>`}
      <${Refused} refusals=${refusalsOf(device)} />
      <p class="facts small soft">
        <span>battery ${battery === null ? "–" : `${battery.toFixed(0)} %`}</span>
        ${device.replay ? html`<span class="file">from ${device.replay}</span>` : html`<span>lost ${device.lost ?? "–"}</span>`}
        ${device.connections > 1 && html`<span>${device.connections} connections</span>`}
      </p>
      <div class="buttons"><button onClick=${() => onOpen(device.name)}>Traces and details<span class="hidden"> of ${device.title} ${device.unit}${device.replay ? ", a replay" : ""}</span></button></div>
    </li>`;
}

// A person's heading says so if what is below it was recorded earlier; both may be there.
function headingOf(device) {
  const person = device.participant || "No participant set";
  return device.replay ? `↻ Replay: ${person}` : person;
}

export function Cards({ live, devices, onOpen }) {
  // In the order of the settings: sorted by name, a card would go elsewhere when its wearer is renamed.
  const headings = [...new Set(devices.map(headingOf))];
  const of = (heading) => devices.filter((each) => headingOf(each) === heading);
  return html`
    <div class="people">
      ${headings.map((heading) => html`
        <section key=${heading} style=${`--cards: ${of(heading).length}`}>
          <h2>${heading}</h2>
          <ul class="cards">
            ${of(heading).map((device) => html`
              <${Card} key=${device.name} live=${live} device=${device} onOpen=${onOpen} />`)}
          </ul>
        </section>`)}
    </div>`;
}

