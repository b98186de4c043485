// Puts states and figures into words. Each state has a sign of its own: colour alone says nothing.

import { html } from "../vendor/preact-htm.js";

const STATES = {
  streaming: ["●", "good", "streaming"],
  partly: ["◐", "warn", "streaming, but some data was changed or dropped"],
  "not worn": ["◐", "warn", "not worn"],
  discovering: ["◌", "warn", "looking for it"],
  connecting: ["◌", "warn", "connecting"],
  enabling: ["▲", "bad", "no data yet"],
  backoff: ["▲", "bad", "will try again"],
  paused: ["❚❚", "warn", "paused: nothing is sent"],
  stopped: ["■", "bad", "stopped"],
};

// A time in a recording; one before its start has a minus.
export function clock(seconds) {
  const whole = Math.floor(Math.abs(seconds));
  const two = (value) => String(value).padStart(2, "0");
  return `${seconds < 0 ? "−" : ""}${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

// A time of day; of another day with its date.
export function momentOf(unixS) {
  const at = new Date(1000 * unixS);
  const time = at.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  return at.toDateString() === new Date().toDateString() ? time : `${at.toLocaleDateString()} ${time}`;
}

export function stateOf(device) {
  if (device.replay) return { sign: "↻", tone: "replayed", word: "replay, not a person" };
  const isOff = device.state === "streaming" && device.worn === false;
  const isPartly = device.state === "streaming" && refusalsOf(device).some((each) => each.now);
  const state = device.paused ? "paused" : isOff ? "not worn" : isPartly ? "partly" : device.state;
  const [sign, tone, word] = STATES[state] ?? ["?", "bad", state];
  return { sign, tone, word };
}

// The agent names its streams; those of the network have numbers only.
export function streamsOf(device) {
  return Object.values(device.streams);
}

// What was not passed on as it came: of a device and all its streams, the worst first. A pause has a state of its own on each card.
export function refusalsOf(device) {
  const ofStreams = streamsOf(device).flatMap((stream) =>
    (stream.refusals ?? []).map((each) => ({ ...each, sentence: `${stream.data_name}: ${each.sentence}` })));
  const all = [...(device.refusals ?? []), ...ofStreams];
  return all.filter((each) => each.what !== "paused").sort((a, b) => (b.level === "error") - (a.level === "error"));
}

export function personOf(device) {
  return [device.participant, device.label].filter(Boolean).join(" · ");
}

// As a person lists them: P01, P02 and P03.
export function listed(names) {
  return [names.slice(0, -1).join(", "), names.at(-1)].filter(Boolean).join(" and ");
}

export function figure(value, unit) {
  if (value === null || value === undefined) return "–";
  if (unit === "boolean") return value > 0.5 ? "yes" : "no";
  const size = Math.abs(value);
  const digits = size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  return `${value.toFixed(digits)}${unit && unit !== "none" ? ` ${unit}` : ""}`;
}

export function rateOf(stream) {
  if (!stream.nominal_hz) return "when it changes";
  const measured = stream.measured_hz === null ? "–" : stream.measured_hz.toFixed(1);
  return `${measured} of ${Number(stream.nominal_hz.toFixed(1))} Hz`;
}

export function ageOf(stream) {
  if (stream.age_s === null) return "nothing yet";
  if (stream.age_s < 60) return `${stream.age_s.toFixed(1)} s`;
  return `${Math.floor(stream.age_s / 60)} min`;
}

export function valueOf(stream) {
  if (!stream.channels.length || !stream.is_fresh || !stream.values.length) return "–";
  return figure(stream.values[0], stream.units[0]);
}

// What is typed or pressed stands out; the same sentences are in the documents.
export function worded(text) {
  return text.split(/(`[^`]+`|\*[A-Z][^*]*\*)/).map((part) => {
    if (part.startsWith("`")) return html`<code>${part.slice(1, -1)}</code>`;
    return /^\*[A-Z]/.test(part) ? html`<em>${part.slice(1, -1)}</em>` : part;
  });
}
