// Captures what a device sends, to help its driver: what leaves is shown before it is saved.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";

const LOOK_MS = 300;
const RUNNING = ["connecting", "capturing"];

function keyOf(device) {
  return `${device.sensor}/${device.unit ?? ""}/${device.name ?? ""}`;
}

function Choice({ devices, onStart, onSetup, onClose }) {
  const [key, setKey] = useState(keyOf(devices[0] ?? {}));
  const device = devices.find((each) => keyOf(each) === key) ?? devices[0];
  if (!device) {
    return html`
      <p>No sensor is set up yet. Find yours first; next to each sensor found, there is a button to capture it.</p>
      <div class="buttons"><button class="main" onClick=${() => { onClose(); onSetup(); }}>Find sensors</button></div>`;
  }
  const start = (event) => {
    event.preventDefault();
    onStart({ sensor: device.sensor, unit: device.unit ?? "", settings: device.settings ?? {} });
  };
  return html`
    <form onSubmit=${start}>
      <label>Sensor
        <select value=${keyOf(device)} onChange=${(event) => setKey(event.target.value)}>
          ${devices.map((each) => html`<option key=${keyOf(each)} value=${keyOf(each)}>${each.title} ${each.name ?? each.unit}</option>`)}
        </select>
      </label>
      <button class="main">Capture it for a minute</button>
    </form>
    <p class="small soft">Put it on, or let someone wear it. Nothing is saved before you have seen what the file would contain, and this program never sends anything.</p>`;
}

function Running({ view, onEnd }) {
  const isConnected = view.phase === "capturing";
  return html`
    <p role="status">${view.title}: ${isConnected ? "listening to it" : "connecting"} …</p>
    ${isConnected && html`
      <label>${Math.floor(view.elapsed_s)} of ${view.seconds.toFixed(0)} s, ${view.packets} packets
        <progress max=${view.seconds} value=${view.elapsed_s}></progress>
      </label>`}
    <div class="buttons"><button onClick=${onEnd}>End it and keep nothing</button></div>`;
}

function Whole() {
  const [lines, setLines] = useState(null);
  const [problem, setProblem] = useState("");
  const load = (event) => {
    if (event.target.open && !lines) ask("GET", "/capture/whole").then(setLines, (error) => setProblem(error.message));
  };
  return html`
    <details onToggle=${load}><summary>All of it, line by line</summary>
      ${problem && html`<p class="reason small">${problem}</p>`}
      ${lines && html`<pre class="fix small found-in-it" tabindex="0">${lines.join("\n")}</pre>`}
    </details>`;
}

function Ready({ view, onSave, onEnd }) {
  const [isAgreed, setAgreed] = useState(false);
  const [note, setNote] = useState("");
  const [folder, setFolder] = useState(view.folder);
  const save = (event) => {
    event.preventDefault();
    onSave({ agreed: true, note, folder });
  };
  return html`
    <h3>What would leave this computer</h3>
    <pre class="fix small" tabindex="0" aria-label="What would leave this computer">${view.lines.join("\n")}</pre>
    ${view.problems.map((sentence) => html`<p class="reason small">The driver reported: ${sentence}</p>`)}
    <${Whole} />
    <h3>The wearer must agree</h3>
    <p>${view.consent}</p>
    <form onSubmit=${save}>
      <label class="check"><input type="checkbox" checked=${isAgreed} onChange=${(event) => setAgreed(event.target.checked)} /> ${view.agreed}</label>
      <label class="wide">What you saw, in one line, without names<input type="text" maxlength="300" value=${note} onInput=${(event) => setNote(event.target.value)} /></label>
      <label class="wide">Save to this folder<input type="text" value=${folder} onInput=${(event) => setFolder(event.target.value)} /></label>
      <button class="main" disabled=${!isAgreed || !folder.trim()}>Save the file</button>
      <button type="button" onClick=${onEnd}>Throw it away</button>
    </form>`;
}

export function Capture({ act, chosen, onSetup, onClose }) {
  const [view, setView] = useState(null);
  const [said, setSaid] = useState("");
  const [problem, setProblem] = useState("");
  const isRunning = RUNNING.includes(view?.phase);
  const look = () => ask("GET", "/capture").then((now) => { setView(now); setProblem(""); }, (error) => setProblem(error.message));
  useEffect(() => { look(); }, []);
  useEffect(() => {
    if (!isRunning) return undefined;
    const timer = setInterval(look, LOOK_MS);
    return () => clearInterval(timer);
  }, [isRunning]);
  const start = async (device) => {
    setSaid("");
    await act("POST", "/capture", device);
    look();
  };
  const save = async (agreement) => {
    try {
      setSaid((await ask("POST", "/capture/save", agreement)).sentence);
      await look();
    } catch (error) {
      setProblem(error.message);
    }
  };
  const end = async () => {
    await act("DELETE", "/capture");
    look();
  };
  // One that was found may be in no settings.
  const others = (view?.devices ?? []).filter((each) => keyOf(each) !== keyOf(chosen ?? {}));
  const devices = chosen ? [chosen, ...others] : others;
  return html`
    <section class="panel" aria-labelledby="capture">
      <div class="card-head">
        <h2 id="capture">Help us: capture a device</h2>
        <div class="buttons"><button onClick=${onClose}>Close<span class="hidden"> the capture</span></button></div>
      </div>
      <p>No driver of this program has met its hardware yet. One minute of your device's bytes, even if everything works, shows whether its driver is right.</p>
      ${problem && html`<p class="reason" role="alert">${problem}</p>`}
      ${said && html`<p role="status" class="file">${said}</p>`}
      ${view?.phase === "failed" && html`<p class="reason" role="alert">${view.title}: ${view.problem}</p>`}
      ${view && ["none", "failed"].includes(view.phase) && html`<${Choice} devices=${devices} onStart=${start} onSetup=${onSetup} onClose=${onClose} />`}
      ${isRunning && html`<${Running} view=${view} onEnd=${end} />`}
      ${view?.phase === "ready" && html`<${Ready} view=${view} onSave=${save} onEnd=${end} />`}
    </section>`;
}
