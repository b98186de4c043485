// One device of the network: traces, entries, and every stream with its names.

import { html, useEffect, useRef } from "../../vendor/preact-htm.js";
import { Copied, Played, Trace, values } from "../detail.js";
import { Features, marksOf } from "../features.js";
import { ageOf, rateOf } from "../words.js";
import { Entries, Seen } from "./cards.js";
import { lostOf } from "./words.js";

const DRAWN = 8;
const MOST = 24;

// A stream as it is drawn: from the channel on that was chosen. Its key is that of the server.
export function windowOf(stream, first) {
  if (!first) return stream;
  const part = stream.windows[first] ?? { channels: [], units: [], values: [] };
  return { ...stream, ...part, source_id: `${stream.source_id}:${first}` };
}

// So many of those that were measured, and all features.
function listed(device) {
  const measured = device.streams.filter((each) => !each.derived_from);
  return [...measured.slice(0, MOST), ...device.streams.filter((each) => each.derived_from)];
}

// What the details need of a device, with the choice of channels by stream.
export function detailStreams(device, firsts) {
  return listed(device).map((each) => windowOf(each, firsts[each.source_id] ?? 0));
}

// What changes once in an hour is in the table.
const isPlotted = (stream) => !stream.derived_from && stream.channels.length > 0 && (stream.is_signal || stream.nominal_hz > 0);

function Choice({ stream, first, onChoose }) {
  if (stream.channel_count <= DRAWN || stream.derived_from) return null;
  const begins = Array.from({ length: Math.ceil(stream.channel_count / DRAWN) }, (_, i) => i * DRAWN);
  const end = (begin) => Math.min(begin + DRAWN, stream.channel_count);
  return html`
    <label class="choice small">Channels of ${stream.data_name}
      <select value=${first} onChange=${(event) => onChoose(Number(event.target.value))}>
        ${begins.map((begin) => html`<option value=${begin}>${begin + 1} to ${end(begin)} of ${stream.channel_count}</option>`)}
      </select>
    </label>`;
}

function Row({ stream }) {
  const newest = stream.is_text ? stream.texts[0]?.text ?? "–" : values(stream);
  return html`
    <tr data-stream=${stream.lsl_name}>
      <th scope="row">${stream.data_name}</th>
      <td><${Seen} each=${stream} />${stream.note && html`<p class="note small">${stream.note}</p>`}</td>
      <td class="figure values">${newest}</td>
      <td class="figure">${rateOf(stream)}</td>
      <td class="figure">${lostOf(stream)}</td>
      <td class="figure">${ageOf(stream)}</td>
      <td><${Copied} text=${stream.lsl_name} /></td>
      <td>${stream.topic && html`<${Copied} text=${stream.topic} />`}</td>
    </tr>`;
}

function Table({ streams }) {
  return html`
    <div class="scroll" tabindex="0" role="region" aria-label="Streams of the device">
      <table>
        <thead><tr>
          <th scope="col">Data</th><th scope="col">State</th><th scope="col" class="figure">Value</th>
          <th scope="col" class="figure">Rate</th><th scope="col" class="figure">Lost</th>
          <th scope="col" class="figure">Newest</th><th scope="col">LSL name</th><th scope="col">ROS topic</th>
        </tr></thead>
        <tbody>${streams.map((each) => html`<${Row} key=${each.source_id} stream=${each} />`)}</tbody>
      </table>
    </div>`;
}

export function SeenDetail({ live, device, firsts, onChoose, onClose }) {
  const heading = useRef();
  useEffect(() => heading.current.focus(), [device.name]);
  const shown = detailStreams(device, firsts);
  const isWorn = device.worn === null ? "" : device.worn ? "worn" : "not worn";
  const battery = device.battery_percent === null ? "" : `battery ${device.battery_percent.toFixed(0)} %`;
  return html`
    <section class="panel" aria-labelledby="detail">
      <div class="card-head">
        <h2 id="detail" ref=${heading} tabindex="-1">${device.title} ${device.unit}</h2>
        <${Seen} each=${device} />
      </div>
      <${Played} device=${device} />
      <p class="facts small soft">
        <span>on ${device.host}</span>${isWorn && html`<span>${isWorn}</span>`}${battery && html`<span>${battery}</span>`}
      </p>
      <div class="buttons"><button onClick=${onClose}>Back to all streams</button></div>
      <${Features} live=${live} device=${device} />
      ${shown.length < device.streams.length && html`<p class="small">The first ${shown.length} of ${device.streams.length} streams are shown.</p>`}
      ${listed(device).map((stream, i) => html`
        <div key=${stream.source_id}>
          <${Choice} stream=${stream} first=${firsts[stream.source_id] ?? 0} onChoose=${(first) => onChoose(stream.source_id, first)} />
          ${isPlotted(shown[i]) && html`<${Trace} key=${shown[i].source_id} live=${live} stream=${shown[i]} marks=${marksOf(device, shown[i])} />`}
          ${stream.is_text && stream.content_type !== "Counters" && html`<h3 class="small">${stream.data_name}</h3><${Entries} stream=${stream} most=${20} />`}
        </div>`)}
      <h3>Streams</h3>
      <${Table} streams=${shown} />
    </section>`;
}
