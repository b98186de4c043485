// The session bar: what is recorded, whether it is complete, and how good it was.

import { html, useState } from "../vendor/preact-htm.js";
import { useOneAtATime } from "./one_at_a_time.js";
import { clock } from "./words.js";

const COLOURS = { green: ["●", "good"], amber: ["◐", "warn"], red: ["▲", "bad"] };

function Progress({ recording, children }) {
  const isWell = !recording.problems.length;
  return html`
    <div class="card-head">
      <p class="state ${isWell ? "good" : "bad"}" role="status">
        <span aria-hidden="true">${isWell ? "●" : "▲"}</span> ${isWell ? "recording, all streams grow" : "recording, but not all is well"}
      </p>
      <p class="facts small">
        <span class="clock">${clock(recording.elapsed_s)}</span>
        <span>${(recording.bytes / 1e6).toFixed(1)} MB</span>
        <span>${recording.streams} streams</span>
      </p>
      ${children}
    </div>
    <p class="small soft file">${recording.file}</p>
    ${recording.problems.length > 0 && html`<ul class="problems" role="alert">${recording.problems.map((each) => html`<li>${each}</li>`)}</ul>`}`;
}

function Running({ recording, act }) {
  const [isUnderWay, once] = useOneAtATime(act);
  return html`
    <${Progress} recording=${recording}>
      <button class="main" disabled=${isUnderWay} onClick=${() => once("POST", "/recording/stop")}>
        ${recording.busy === "ending" ? "Ending and checking …" : "Stop recording"}
      </button>
    <//>`;
}

// For who only looks on.
export function State({ recording }) {
  if (recording.is_running) return html`<${Progress} recording=${recording} />`;
  if (recording.verdict) return html`<${Verdict} verdict=${recording.verdict} />`;
  return html`<p>nothing is recorded</p>`;
}

function Verdict({ verdict }) {
  const [sign, tone] = COLOURS[verdict.colour] ?? COLOURS.red;
  return html`
    <div class="verdict">
      <p class="state ${tone}"><span aria-hidden="true">${sign}</span> ${verdict.sentence}</p>
      <p class="small soft file">${verdict.file}</p>
      ${verdict.findings.length > 0 && html`<details><summary>What was found (${verdict.findings.length})</summary><ul class="small">${verdict.findings.map((each) => html`<li>${each}</li>`)}</ul></details>`}
    </div>`;
}

function Begin({ recording, act, fields, setFields }) {
  const [isLax, setLax] = useState(false);
  const [isUnderWay, once] = useOneAtATime(act);
  const set = (name) => (event) => setFields({ ...fields, [name]: event.target.value });
  const begin = (event) => {
    event.preventDefault();
    once("POST", "/recording/start", { ...fields, allow_missing: isLax });
  };
  const box = (name, label, more = {}) => html`
    <label>${label}<input type="text" value=${fields[name]} onInput=${set(name)} ...${more} /></label>`;
  return html`
    <form onSubmit=${begin}>
      ${box("participant", "Participant (a pseudonym)", { required: true, pattern: "[A-Za-z0-9]+", title: "letters and digits" })}
      ${box("session", "Session", { required: true, pattern: "[A-Za-z0-9]+", title: "letters and digits" })}
      ${box("task", "Task", { required: true, pattern: "[A-Za-z0-9]+", title: "letters and digits" })}
      ${box("folder", "Folder", { placeholder: recording.folder, size: 34 })}
      <button class="main" disabled=${isUnderWay}>${isUnderWay || recording.busy !== "" ? "Opening all streams …" : "Record"}</button>
      <label class="check"><input type="checkbox" checked=${isLax} onChange=${(event) => setLax(event.target.checked)} /> also without streams that are missing</label>
    </form>`;
}

export function Session({ recording, act }) {
  // Here, so that the next recording of a person needs no typing.
  const [fields, setFields] = useState({ participant: "", session: "S001", task: "Default", folder: "" });
  return html`
    <section class="panel" aria-labelledby="session">
      <h2 id="session">Recording</h2>
      ${recording.is_running ? html`<${Running} recording=${recording} act=${act} />` : html`
        ${recording.file && !recording.verdict && html`
          <ul class="problems" role="alert">${recording.problems.map((each) => html`<li>${each}</li>`)}</ul>
          <button onClick=${() => act("POST", "/recording/stop")}>Close and check it</button>`}
        <${Begin} recording=${recording} act=${act} fields=${fields} setFields=${setFields} />`}
      ${!recording.is_running && recording.verdict && html`<${Verdict} verdict=${recording.verdict} />`}
    </section>`;
}
