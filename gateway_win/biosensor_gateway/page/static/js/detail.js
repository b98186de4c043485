// One device: traces, every stream with its names, and what can be done with the device.

import { html, useEffect, useRef, useState } from "../vendor/preact-htm.js";
import { Access } from "./access.js";
import { State } from "./cards.js";
import { lineOf, Plot } from "./draw.js";
import { Features, featuresOf, marksOf } from "./features.js";
import { Clock, Log } from "./inside.js";
import { useKept } from "./kept.js";
import { AllRefused } from "./refusals.js";
import { ageOf, figure, rateOf, refusalsOf, streamsOf } from "./words.js";

const NAMED = 12;
const VALUES = 5;

function Line({ channel }) {
  const { colour, dash } = lineOf(channel);
  return html`<svg width="28" height="8" aria-hidden="true"><line x1="0" y1="4" x2="28" y2="4" style=${{ stroke: colour }} stroke-width="2" stroke-dasharray=${dash} /></svg>`;
}

export function Trace({ live, stream, marks = [] }) {
  const place = useRef();
  const shown = useRef();
  shown.current = marks;
  const names = stream.channels.join();
  useEffect(() => {
    const plot = new Plot(place.current, live, stream);
    const draw = () => plot.draw(shown.current);
    live.onPicture.add(draw);
    return () => {
      live.onPicture.delete(draw);
      plot.end();
    };
  }, [live, stream.source_id, names]);
  const units = [...new Set(stream.units)].join(", ");
  return html`
    <figure class="plot">
      <figcaption>
        <strong>${stream.data_name}</strong> <span class="soft small">${units}</span>
        ${stream.channels.length > 1 && html`<ul class="legend small">${stream.channels.slice(0, NAMED).map((label, c) => html`<li><${Line} channel=${c} />${label}</li>`)}
          ${stream.channels.length > NAMED && html`<li class="soft">and ${stream.channels.length - NAMED} more</li>`}</ul>`}
        ${marks.length > 0 && html`<span class="marks-named soft small">${marks.map((each) => each.words).join(", ")}</span>`}
      </figcaption>
      <div ref=${place} role="img" aria-label=${`trace of ${stream.data_name}; its values are in the table`}></div>
    </figure>`;
}

export function Copied({ text }) {
  const [isDone, setDone] = useState(false);
  const copy = async () => {
    await navigator.clipboard.writeText(text);
    setDone(true);
    setTimeout(() => setDone(false), 1500);
  };
  return html`<code>${text}</code> <button class="plain small" onClick=${copy}>${isDone ? "copied" : "copy"}<span class="hidden"> ${text}</span></button>`;
}

function Streams({ device }) {
  return html`
    <div class="scroll" tabindex="0" role="region" aria-label="Streams of the device">
      <table>
        <thead><tr>
          <th scope="col">Data</th><th scope="col" class="figure">Value</th><th scope="col" class="figure">Rate</th>
          <th scope="col" class="figure">Lost</th><th scope="col" class="figure">Newest</th>
          <th scope="col">LSL name</th><th scope="col">ROS topic</th>
        </tr></thead>
        <tbody>
          ${[...streamsOf(device), ...featuresOf(device)].map((stream) => html`
            <tr key=${stream.source_id} data-stream=${stream.source_id}>
              <th scope="row">${stream.data_name}</th>
              <td class="figure values">${values(stream)}</td>
              <td class="figure">${stream.silent ? "switched off" : rateOf(stream)}</td>
              <td class="figure">${device.is_sending === false ? "–" : stream.lost ?? "–"}</td>
              <td class="figure">${ageOf(stream)}</td>
              <td><${Copied} text=${stream.lsl_name} /></td>
              <td>${stream.topic ? html`<${Copied} text=${stream.topic} />` : "–"}</td>
            </tr>`)}
        </tbody>
      </table>
    </div>`;
}

export function values(stream) {
  if (!stream.is_fresh || !stream.values.length) return "–";
  const isOneUnit = new Set(stream.units).size === 1 && stream.units[0] !== "boolean";
  const shown = stream.values.slice(0, VALUES).map((value, c) => figure(value, isOneUnit ? "none" : stream.units[c]));
  const more = stream.values.length - shown.length;
  const unit = isOneUnit && stream.units[0] !== "none" ? ` ${stream.units[0]}` : "";
  return shown.join(", ") + unit + (more > 0 ? `, and ${more} more` : "");
}

function Edit({ device, act }) {
  const [typed, setTyped] = useKept(`worn ${device.name}`, { participant: null, label: null });
  const participant = typed.participant ?? device.participant;
  const label = typed.label ?? device.label;
  const isNew = participant !== device.participant || label !== device.label;
  const save = async (event) => {
    event.preventDefault();
    const isSaved = await act("PATCH", "/devices", { sensor: device.sensor, unit: device.unit, participant, label });
    if (isSaved) setTyped({ participant: null, label: null });
  };
  return html`
    <form onSubmit=${save}>
      <label>Participant (a pseudonym)
        <input type="text" maxlength="32" value=${participant} onInput=${(event) => setTyped({ participant: event.target.value })} />
      </label>
      <label>Label, such as left
        <input type="text" maxlength="32" value=${label} onInput=${(event) => setTyped({ label: event.target.value })} />
      </label>
      <button>Save</button>
      ${isNew && html`<span class="small warned">not saved yet</span>`}
    </form>
    <p class="small soft">Saving creates new streams: their names contain participant and label. Other devices continue to stream.</p>`;
}

// Says of traces that nobody is measured now.
export function Played({ device }) {
  return device.replay && html`<p class="notice-line">This is a replay of <span class="file">${device.replay}</span>. It was recorded earlier; nobody is being measured now.</p>`;
}

export function Detail({ live, device, isVirtual, act, onCapture, onClose }) {
  const heading = useRef();
  useEffect(() => heading.current.focus(), [device.name]);
  const which = { sensor: device.sensor, unit: device.unit };
  const worn = { ...which, participant: device.participant, label: device.label };
  const remove = () => {
    if (confirm(`Remove ${device.title} ${device.unit} from the settings? Its streams end.`)) {
      act("DELETE", "/devices", which).then((isDone) => isDone && onClose());
    }
  };
  // What tells of the device itself, such as its battery, changes too rarely for ten seconds.
  const isSlow = (each) => !each.is_signal && !each.nominal_hz;
  const plotted = streamsOf(device).filter((each) => each.channels.length && each.content_type !== "Markers" && !each.silent && !each.is_empty && !isSlow(each));
  return html`
    <section class="panel" aria-labelledby="detail">
      <div class="card-head">
        <h2 id="detail" ref=${heading} tabindex="-1">${device.title} ${device.unit}</h2>
        <${State} device=${device} />
      </div>
      <${Played} device=${device} />
      ${device.error && html`<p class="reason">${device.error}</p>`}
      <div class="buttons">
        <button onClick=${onClose}>Back to all devices</button>
        ${!act ? null : device.paused
          ? html`<button onClick=${() => act("POST", "/devices/resume", worn)}>Resume</button>`
          : html`<button onClick=${() => act("POST", "/devices/pause", worn)}>Pause (withdrawal)</button>`}
        ${act && !isVirtual && html`<button onClick=${remove}>Remove …</button>`}
        ${act && !isVirtual && onCapture && html`<button onClick=${() => onCapture({ ...which, title: device.title })}>Help us: capture this device</button>`}
      </div>
      <${Features} live=${live} device=${device} />
      ${plotted.map((stream) => html`<${Trace} key=${stream.source_id} live=${live} stream=${stream} marks=${marksOf(device, stream)} />`)}
      <h3>Streams</h3>
      <${Streams} device=${device} />
      <${AllRefused} refusals=${refusalsOf(device)} />
      ${!device.replay && html`<${Clock} clock=${device.clock} />`}
      ${act && html`<${Log} device=${device} />`}
      ${act && !isVirtual && html`<h3>Who wears it</h3><${Edit} key=${device.name} device=${device} act=${act} />
        <${Access} sensor=${device.sensor} act=${act} />`}
    </section>`;
}
