// A card for each device, and for each name that another program gives its streams.

import { html, useEffect, useRef } from "../../vendor/preact-htm.js";
import { mainStreams } from "../cards.js";
import { Features, marksOf, shownFeatures } from "../features.js";
import { Spark } from "../spark.js";
import { rateOf, valueOf } from "../words.js";
import { lostOf, seenOf, span, trafficOf } from "./words.js";

// Receiving a stream costs its sender's network as much; a card must not begin that by itself.
const MOST_BYTES = 1e6;
const TEXTS = 3;
const NAMED = 6;
const NOTES = 3;

export function Seen({ each }) {
  const { sign, tone, word } = seenOf(each);
  return html`<span class="state ${tone}"><span aria-hidden="true">${sign}</span> ${word}</span>`;
}

const isHeavy = (stream) => stream.bytes_per_s > MOST_BYTES;
const isSlow = (stream) => !stream.is_text && !stream.is_signal && !stream.derived_from && stream.nominal_hz <= 2;
const drawn = (device) => mainStreams({ streams: device.streams.filter((each) => !isHeavy(each)) });
const texts = (device) => device.streams.filter((each) => each.is_text && each.content_type !== "Counters").slice(0, TEXTS);

// What the card of a device needs: its traces, its entries, and what tells battery and contact.
export function cardStreams(device) {
  return [...drawn(device), ...texts(device), ...shownFeatures(device), ...(device.is_ours ? device.streams.filter(isSlow) : [])];
}

export function Entries({ stream, most }) {
  if (!stream.texts.length) return html`<p class="small soft">${stream.data_name}: no entry since this page was opened</p>`;
  return html`
    <ul class="entries small" aria-label=${`newest entries of ${stream.data_name}`}>
      ${stream.texts.slice(0, most).map((each) => html`
        <li><span class="text">${each.text}</span><span class="age soft">${span(each.age_s)} ago</span></li>`)}
    </ul>`;
}

function Unseen({ streams }) {
  if (!streams.length) return null;
  const names = streams.slice(0, NAMED).map((each) => `${each.data_name} (${trafficOf(each)})`).join(", ");
  return html`<p class="small soft">Not received until you open the details: ${names}${streams.length > NAMED ? " …" : ""}</p>`;
}

function Card({ live, device, visible, onOpen }) {
  const card = useRef();
  useEffect(() => {
    const watch = new IntersectionObserver((seen) => {
      if (seen.at(-1).isIntersecting) visible.add(device.name);
      else visible.delete(device.name);
    }, { rootMargin: "100px" });
    watch.observe(card.current);
    return () => {
      watch.disconnect();
      visible.delete(device.name);
    };
  }, [device.name]);
  const { battery_percent: battery, streams } = device;
  const notes = streams.filter((each) => each.note);
  return html`
    <li ref=${card} class="card ${device.replay ? "replay" : ""}" data-device=${device.title}>
      <div class="card-head">
        <h3>${device.title} <span class="soft small">${device.label || device.unit}</span></h3>
        <${Seen} each=${device} />
      </div>
      <div class="sparks">
        ${drawn(device).map((stream) => html`
          <span class="small">${stream.data_name}</span>
          <${Spark} live=${live} stream=${stream} marks=${marksOf(device, stream)} />
          <span class="value small" title=${rateOf(stream)}>${valueOf(stream)}</span>`)}
      </div>
      <${Features} live=${live} device=${device} />
      ${texts(device).map((stream) => html`<${Entries} key=${stream.source_id} stream=${stream} most=${3} />`)}
      <${Unseen} streams=${streams.filter(isHeavy)} />
      ${notes.slice(0, NOTES).map((each) => html`<p class="note small">${each.data_name}: ${each.note}</p>`)}
      ${notes.length > NOTES && html`<p class="note small">and ${notes.length - NOTES} more, in the details</p>`}
      <p class="facts small soft">
        <span>on ${device.host}</span>
        ${device.replay && html`<span class="file">replay of ${device.replay}</span>`}
        ${battery !== null && html`<span>battery ${battery.toFixed(0)} %</span>`}
        <span>lost ${lostOf(device)}</span>
        <span>${streams.length === 1 ? "1 stream" : `${streams.length} streams`}</span>
      </p>
      <div class="buttons"><button onClick=${() => onOpen(device.name)}>Traces and details<span class="hidden"> of ${device.title} ${device.unit || device.host}</span></button></div>
    </li>`;
}

export function SeenCards({ live, devices, visible, onOpen }) {
  const sections = [...new Set(devices.map((each) => each.section))];
  return sections.map((section) => html`
    <section key=${section}>
      <h2>${section}</h2>
      <ul class="cards">
        ${devices.filter((each) => each.section === section).map((device) => html`
          <${Card} key=${device.name} live=${live} device=${device} visible=${visible} onOpen=${onOpen} />`)}
      </ul>
    </section>`);
}
