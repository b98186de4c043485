// Live features: numbers with the quality of their signal, and what is marked in its traces.

import { html } from "../vendor/preact-htm.js";
import { Spark } from "./spark.js";
import { figure, streamsOf } from "./words.js";

// In this order; what is not here is in the table of the details.
const NUMBERS = new Map([
  ["hr_live", "heart rate"],
  ["hrv_live", "HRV, RMSSD"],
  ["br_live", "breathing rate"],
  ["scl", "skin level"],
  ["scr", "skin response"],
  ["activity_live", "activity"],
]);

// Those of which a stream beside them says each second what the newest is, how old, and how good;
// and from which age in s on that is said. One beat or breath later is not old.
const STATES = new Map([["hr_live", { name: "hr_state", old_s: 3 }], ["br_live", { name: "br_state", old_s: 8 }]]);
const IS_STATE = new Set([...STATES.values()].map((each) => each.name));

const artefacts = (rows) => !(rows[1] > 0.5);
// Which of their samples have a filled sign, and what the signs mean.
const MARKS = new Map([
  ["beats", { isFilled: artefacts, words: "▼ beat, ▽ artefact" }],
  ["scr", { isFilled: () => false, words: "▽ skin response" }],
  ["scr_prominent", { isFilled: () => true, words: "▼ prominent one" }],
  ["breaths", { isFilled: () => true, words: "▼ end of breathing in" }],
]);

// A quality is from 0 to 1.
const GOOD = 0.8;
const FAIR = 0.5;
const isQuality = (each) => each.data_name.endsWith("_sqi");

// All features of a device. Two programs may send the same ones, of which one may have ended.
export function featuresOf(device) {
  const found = device.features ?? streamsOf(device).filter((each) => each.derived_from);
  const kept = new Map();
  for (const each of found) {
    const name = `${each.derived_from} ${each.data_name}`;
    if (!kept.get(name)?.is_fresh) kept.set(name, each);
  }
  return [...kept.values()];
}

// What a card needs of them.
export function shownFeatures(device) {
  return featuresOf(device).filter((each) => NUMBERS.has(each.data_name) || MARKS.has(each.data_name) || IS_STATE.has(each.data_name) || isQuality(each));
}

// What is marked in the trace of a stream.
export function marksOf(device, stream) {
  return featuresOf(device)
    .filter((each) => MARKS.has(each.data_name) && each.derived_from === stream.source_id)
    .map((each) => ({ source_id: each.source_id, ...MARKS.get(each.data_name) }));
}

// What the stream beside a rate says now; null where there is none, or it says nothing any more.
function stateOf(device, feature) {
  const beside = STATES.get(feature.data_name);
  const state = featuresOf(device).find((each) => each.data_name === beside?.name && each.derived_from === feature.derived_from);
  if (!state?.is_fresh || !state.values.length) return null;
  const of = (label) => state.values[state.channels.indexOf(label)] ?? null;
  return { value: state.values[0], unit: state.units[0], age_s: of("age"), old_s: beside.old_s, intervals: of("intervals") };
}

function qualityOf(device, feature) {
  const quality = featuresOf(device).find((each) => isQuality(each) && each.derived_from === feature.derived_from);
  if (!quality?.is_fresh || !quality.values.length || quality.values[0] === null) return null;
  const [now, ...flags] = quality.values;
  // HRV looks further back than the quality of its signal, and says the lowest of its window.
  const value = Math.min(now, feature.values[feature.channels.indexOf("quality_30s")] ?? now);
  const reasons = quality.channels.slice(1).filter((_, i) => flags[i] > 0.5).map((each) => each.replaceAll("_", " "));
  const [sign, tone, word] = value >= GOOD ? ["●", "good", "good"] : value >= FAIR ? ["◐", "warn", "fair"] : ["▲", "bad", "poor"];
  return { sign, tone, signal: quality.data_name.slice(0, -"_sqi".length), word: reasons.length ? `${word}: ${reasons.join(", ")}` : word };
}

// What holds is of now; of what has happened, it stands when.
function shownValue(feature, state) {
  if (state) {
    if (state.value === null) return "–";
    const old = state.age_s >= state.old_s ? `, ${state.age_s.toFixed(0)} s ago` : "";
    return `${figure(state.value, state.unit)}${old}`;
  }
  if (!feature.is_fresh || !feature.values.length || feature.values[0] === null) return "–";
  const value = figure(feature.values[0], feature.units[0]);
  return feature.data_name === "scr" ? `${value}, ${feature.age_s.toFixed(0)} s ago` : value;
}

function Row({ live, device, feature }) {
  const state = stateOf(device, feature);
  const value = shownValue(feature, state);
  // Where there is no value, nothing is good.
  const known = qualityOf(device, feature);
  const quality = value === "–" && known?.tone === "good" ? null : known;
  const what = state?.value == null ? feature.channels[0] : `${feature.channels[0]}, mean of ${state.intervals} intervals`;
  return html`
    <span class="small" title=${feature.data_name}>${NUMBERS.get(feature.data_name)}</span>
    <${Spark} live=${live} stream=${feature} />
    <span class=${`value small ${quality?.tone === "bad" ? "doubtful" : ""}`} title=${what} data-feature=${feature.data_name}>${value}</span>
    <span class="state small ${quality?.tone ?? ""}" title=${quality ? `quality of ${quality.signal}: ${quality.word}` : ""}>
      <span aria-hidden="true">${quality?.sign}</span>${quality && html`<span class="hidden">quality ${quality.word}</span>`}
    </span>`;
}

// Of each signal that is not good, why.
function Doubts({ device, numbers }) {
  const found = numbers.map((each) => qualityOf(device, each)).filter((each) => each && each.tone !== "good");
  const sentences = [...new Set(found.map((each) => `${each.signal} is ${each.word}`))];
  return sentences.length > 0 && html`<p class="note small">${sentences.join("; ")}</p>`;
}

export function Features({ live, device }) {
  const numbers = [...NUMBERS.keys()].flatMap((name) => featuresOf(device).filter((each) => each.data_name === name));
  if (!numbers.length) return null;
  return html`
    <div class="features" role="group" aria-label="Live features">
      ${numbers.map((each) => html`<${Row} key=${each.source_id} live=${live} device=${device} feature=${each} />`)}
    </div>
    <${Doubts} device=${device} numbers=${numbers} />`;
}
