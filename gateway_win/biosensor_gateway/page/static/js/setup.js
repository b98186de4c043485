// Finds devices and adds them to the settings.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { DeviceTest } from "./device_test.js";

const LOOK_MS = 300;

function Found({ device, act, onCapture }) {
  const [participant, setParticipant] = useState("");
  const [label, setLabel] = useState("");
  const add = (event) => {
    event.preventDefault();
    act("POST", "/devices", { sensor: device.sensor, settings: device.settings, participant, label });
  };
  const name = device.name.startsWith(device.title) ? device.name : `${device.title}: ${device.name}`;
  return html`
    <li>
      <div class="card-head">
        <h3>${name}</h3>
        ${device.rssi_dbm !== null && html`<span class="soft small">signal ${device.rssi_dbm} dBm</span>`}
      </div>
      ${device.is_known
        ? html`<p class="small soft">It is one of your sensors: its card is below.</p>`
        : html`
          <form onSubmit=${add}>
            <label>Participant (a pseudonym)
              <input type="text" maxlength="32" value=${participant} onInput=${(event) => setParticipant(event.target.value)} />
            </label>
            <label>Label, such as left
              <input type="text" maxlength="32" value=${label} onInput=${(event) => setLabel(event.target.value)} />
            </label>
            <button class="main">Add<span class="hidden"> ${name}</span></button>
          </form>
          <${DeviceTest} sensor=${device.sensor} settings=${device.settings} name=${name} />
          <div><button type="button" onClick=${() => onCapture({ sensor: device.sensor, settings: device.settings, title: device.title, name: device.name })}>Help us: capture this device<span class="hidden"> ${name}</span></button></div>`}
    </li>`;
}

export function Setup({ act, onCapture, onClose, configured }) {
  const [search, setSearch] = useState(null);
  const isRunning = search?.running ?? false;
  const places = search?.places ?? [];
  const found = places.flatMap((each) => each.found);
  const failed = places.filter((each) => each.problem);
  const look = async (method) => setSearch(await ask(method, "/search"));
  const [problem, setProblem] = useState("");
  const start = async () => {
    setProblem("");
    // One that goes on already is shown, too.
    await look("POST").catch(() => look("GET")).catch((error) => setProblem(error.message));
  };
  useEffect(() => { start(); }, []);
  // Once more when a device was added, so that it is shown as known.
  useEffect(() => { if (search && !isRunning) look("GET").catch(() => {}); }, [configured]);
  useEffect(() => {
    if (!isRunning) return undefined;
    const timer = setInterval(() => look("GET").catch(() => {}), LOOK_MS);
    return () => clearInterval(timer);
  }, [isRunning]);
  return html`
    <section class="panel" aria-labelledby="setup">
      <div class="card-head">
        <h2 id="setup">Sensors near this computer</h2>
        <div class="buttons">
          <button onClick=${start} disabled=${isRunning}>Search again</button>
          <button onClick=${onClose}>Close</button>
        </div>
      </div>
      ${problem && html`<p class="reason" role="alert">${problem}</p>`}
      ${!search && !problem && html`<p role="status">Starting the search …</p>`}
      ${isRunning && html`
        <label>Searching by Bluetooth, at serial ports and at the vendors' programs. Put your sensors on, or switch them on.
          <progress max=${search.seconds} value=${search.elapsed_s}></progress>
        </label>`}
      <ul class="found">${found.map((device) => html`<${Found} key=${device.sensor + device.name} device=${device} act=${act} onCapture=${onCapture} />`)}</ul>
      ${search?.done && !found.length && html`<p>No sensor was found. Is it charged, switched on, near, and worn?</p>`}
      ${places.flatMap((each) => each.advice).map((sentence) => html`<p class="small">${sentence}</p>`)}
      ${failed.length > 0 && html`
        <details><summary>Places that could not be searched</summary>
          <ul>${failed.map((each) => html`<li class="small">${each.where}: ${each.problem}</li>`)}</ul>
        </details>`}
    </section>`;
}
