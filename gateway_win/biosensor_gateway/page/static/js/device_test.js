// Connects to a device that was found, to see what it sends before it is added.

import { html, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";

function Outcome({ outcome }) {
  if (outcome.refused) return html`<p class="reason small">${outcome.refused}</p>`;
  const isWell = outcome.connected && !outcome.problems.length;
  const rate = (each) => {
    if (!each.nominal_hz) return `${each.samples} ${each.samples === 1 ? "value" : "values"}`;
    const measured = each.measured_hz === null ? "nothing" : `${each.measured_hz.toFixed(1)} Hz`;
    return `${measured} of ${Number(each.nominal_hz.toFixed(1))} Hz`;
  };
  return html`
    <div class="small">
      <p class="state ${isWell ? "good" : "bad"}"><span aria-hidden="true">${isWell ? "●" : "▲"}</span> ${isWell ? "it works" : outcome.connected ? "it is connected, but something is wrong" : "it could not be connected"}</p>
      ${outcome.problems.map((sentence) => html`<p class="reason">${sentence}</p>`)}
      ${outcome.connected && html`<ul class="legend">${Object.entries(outcome.streams).map(([name, each]) => html`<li>${name}: ${rate(each)}</li>`)}</ul>`}
    </div>`;
}

export function DeviceTest({ sensor, settings, name }) {
  const [isRunning, setRunning] = useState(false);
  const [outcome, setOutcome] = useState(null);
  const run = async () => {
    setRunning(true);
    setOutcome(null);
    try {
      setOutcome(await ask("POST", "/devices/test", { sensor, settings }));
    } catch (error) {
      setOutcome({ refused: error.message });
    }
    setRunning(false);
  };
  return html`
    <div>
      <button type="button" onClick=${run} disabled=${isRunning}>${isRunning ? "Connecting and listening …" : "Test"}<span class="hidden"> ${name}</span></button>
      <div role="status">${outcome && html`<${Outcome} outcome=${outcome} />`}</div>
    </div>`;
}
