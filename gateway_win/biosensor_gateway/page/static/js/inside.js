// What a device's clock does, and what the log says last of the device.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";

const LOOK_MS = 2000;
const SIGNS = { warning: ["▲", "warn", "warning"], error: ["▲", "bad", "error"], critical: ["▲", "bad", "error"] };

function jumps(count) {
  if (!count) return "none";
  return count === 1 ? "once" : `${count} times`;
}

export function Clock({ clock }) {
  if (!clock) return html`<h3>Clock</h3><p class="small soft">Known while the device is sending, from its first packet.</p>`;
  const anHour = Math.abs(clock.drift_ppm * 3.6);
  return html`
    <h3>Clock</h3>
    <dl class="pairs small" aria-label="Clock of the device">
      <dt>Offset</dt><dd>${clock.offset_s.toFixed(4)} s</dd>
      <dt>Drift</dt><dd>${clock.drift_ppm.toFixed(2)} ppm: it ${clock.drift_ppm > 0 ? "loses" : "gains"} ${anHour.toFixed(1)} ms an hour</dd>
      <dt>Scatter (RMS)</dt><dd>${(1000 * clock.residual_rms_s).toFixed(2)} ms</dd>
      <dt>Packets</dt><dd>${clock.observations}</dd>
      <dt>Jumps</dt><dd>${jumps(clock.reanchors)}</dd>
    </dl>
    <p class="small soft">LSL's clock minus the device's own; how fast the two drift apart; how far the earliest packets are from that line. Time stamps follow the line.</p>`;
}

function Entry({ line }) {
  const [sign, tone, word] = SIGNS[line.level] ?? ["", "", ""];
  const time = new Date(line.time);
  return html`<li><time datetime=${line.time}>${Number.isNaN(time.valueOf()) ? "" : time.toLocaleTimeString()}</time> ${word && html`<span class="state ${tone}"><span aria-hidden="true">${sign}</span> ${word}:</span>`} ${line.sentence}</li>`;
}

export function Log({ device }) {
  const { sensor, unit, participant, label } = device;
  const [lines, setLines] = useState(null);
  const [problem, setProblem] = useState("");
  useEffect(() => {
    let isOpen = true;
    const look = async () => {
      try {
        const log = await ask("GET", `/devices/log?${new URLSearchParams({ sensor, unit, participant, label })}`);
        if (isOpen) setLines(log.lines);
        if (isOpen) setProblem("");
      } catch (error) {
        if (isOpen) setProblem(error.message);
      }
    };
    look();
    const timer = setInterval(look, LOOK_MS);
    return () => { isOpen = false; clearInterval(timer); };
  }, [sensor, unit, participant, label]);
  return html`
    <h3>Latest log entries</h3>
    ${problem && html`<p class="reason small">${problem}</p>`}
    ${lines && !lines.length && html`<p class="small soft">Nothing about this device.</p>`}
    ${lines?.length > 0 && html`<div class="log small" tabindex="0" role="region" aria-label="Log of the device, the newest first"><ul>${lines.map((line) => html`<${Entry} line=${line} />`)}</ul></div>`}`;
}
