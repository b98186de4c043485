// The session bar: what is recorded, whether it is complete, and how good it was.

import { html, useEffect } from "../vendor/preact-htm.js";
import { Explained } from "./findings.js";
import { useKept } from "./kept.js";
import { useOneAtATime } from "./one_at_a_time.js";
import { Alarm } from "./title.js";
import { clock, listed, worded } from "./words.js";

// A sign, a tone, a sentence, and the same for a narrow place.
export const COLOURS = {
  green: ["●", "good", "recording, all streams are growing", "recording"],
  amber: ["◐", "warn", "recording, all streams are growing except as noted below", "recording, with a note"],
  red: ["▲", "bad", "recording, but something is wrong", "recording, something is wrong"],
};

export const OPENING = "Opening all streams …";

function Progress({ recording, children }) {
  const [sign, tone, word] = COLOURS[recording.colour] ?? COLOURS.red;
  return html`
    <div class="card-head">
      <p class="state ${tone}" role="status"><span aria-hidden="true">${sign}</span> ${word}</p>
      <p class="facts small">
        <span class="clock">${clock(recording.elapsed_s)}</span>
        <span>${(recording.bytes / 1e6).toFixed(1)} MB</span>
        <span>${recording.streams} streams</span>
      </p>
      ${children}
    </div>
    <p class="small soft file">${recording.file}</p>
    ${recording.problems.length > 0 && html`<ul class="problems" role="alert">${recording.problems.map((each) => html`<li>${worded(each)}</li>`)}</ul>`}
    ${recording.notes.length > 0 && html`<ul class="notes" aria-label="Other problems">${recording.notes.map((each) => html`<li>${worded(each)}</li>`)}</ul>`}
    ${recording.remarks.map((each) => html`<p class="small soft file">${each}</p>`)}`;
}

function Running({ recording, act }) {
  const [isUnderWay, once] = useOneAtATime(act);
  return html`
    <${Progress} recording=${recording}>
      <button class="main" data-clear disabled=${isUnderWay} onClick=${() => once("POST", "/recording/stop")}>
        ${recording.busy === "ending" ? "Ending and checking …" : "Stop recording"}
      </button>
    <//>`;
}

// For who only looks on.
export function State({ recording }) {
  if (recording.is_running) return html`<${Progress} recording=${recording} />`;
  if (recording.busy) return html`<p>${OPENING}</p>`;
  if (recording.verdict) return html`<${Verdict} verdict=${recording.verdict} />`;
  return html`<p>not recording</p>`;
}

// Of a recording that was cut off, as on a full disk. For who only looks on, only what came of it.
function Salvage({ verdict, act }) {
  const [isUnderWay, once] = useOneAtATime(act);
  if (verdict.salvaged) return html`<p class="small file">All its readable data is in ${verdict.salvaged}</p>`;
  if (!act || !verdict.can_be_salvaged) return null;
  return html`
    <div class="buttons">
      <button disabled=${isUnderWay} onClick=${() => once("POST", "/recording/salvage")}>${isUnderWay ? "Salvaging …" : "Salvage it"}</button>
      <span class="small soft">Writes the readable data to a new file next to it and does not change it. This needs as much disk space again.</span>
    </div>`;
}

function Verdict({ verdict, act }) {
  const [sign, tone] = COLOURS[verdict.colour] ?? COLOURS.red;
  return html`
    <div class="verdict">
      <p class="state ${tone}"><span aria-hidden="true">${sign}</span> ${worded(verdict.sentence)}</p>
      <p class="small soft file">${verdict.file}</p>
      <${Salvage} verdict=${verdict} act=${act} />
      ${verdict.findings.length > 0 && html`<details open=${verdict.colour === "red"}><summary>What was found (${verdict.explained.length})</summary><div class="explained" tabindex="0"><${Explained} findings=${verdict.explained} /></div></details>`}
    </div>`;
}

const NAME = { required: true, pattern: "[A-Za-z0-9]+", title: "letters and digits" };

// Whether the sensors are worn by whoever the next file is called after; if not, they can be set so.
function Wearers({ status, people, participant, act }) {
  const [isUnderWay, once] = useOneAtATime(act);
  const set = () => once("PUT", "/participant", { participant });
  const isGroup = people.length > 1 && participant.toLowerCase().startsWith("group");
  const isWorn = people.length === 1 && people[0] === participant;
  const isEmpty = !people.length && (!participant || status.virtual);
  if (!status.devices.length || (!isUnderWay && (isGroup || isWorn || isEmpty))) return null;
  const worn = people.length ? `The sensors are worn by ${listed(people)}.` : "No participant is set for the sensors.";
  const isSettable = !status.virtual && status.one_wearer && new RegExp(`^(?:${NAME.pattern})$`).test(participant);
  return html`
    <div class="buttons wearers small">
      <span>${worn}${people.length > 1 && " For one file of several people, type a group, such as group01."}</span>
      ${isSettable && html`<button type="button" disabled=${isUnderWay} onClick=${set}>${isUnderWay ? "Waiting for the sensors …" : `Set all sensors to ${participant}`}</button>`}
    </div>`;
}

function Begin({ status, act }) {
  const { recording } = status;
  const [fields, setFields] = useKept("recording", { participant: null, session: "S001", task: "Default", folder: "", only_ours: false });
  const [{ isLax }, setLax] = useKept("recording-lax", { isLax: false });
  const [isUnderWay, once] = useOneAtATime(act);
  const people = [...new Set(status.devices.map((each) => each.participant).filter(Boolean))];
  // Until somebody types another one, it is who wears the sensors.
  const participant = fields.participant ?? (people.length === 1 ? people[0] : "");
  const isAsWorn = people.length === 1 && fields.participant === people[0];
  useEffect(() => { if (isAsWorn) setFields({ participant: null }); }, [isAsWorn]);
  const set = (name) => (event) => setFields({ [name]: event.target.value });
  const begin = async (event) => {
    event.preventDefault();
    const isBegun = await once("POST", "/recording/start", { ...fields, participant, allow_missing: isLax });
    // It is meant for one recording, and not for the next.
    if (isBegun) setLax({ isLax: false });
  };
  const box = (name, label, value, more = {}) => html`
    <label>${label}<input type="text" value=${value} onInput=${set(name)} ...${more} /></label>`;
  return html`
    <form onSubmit=${begin}>
      ${box("participant", "Participant now (a pseudonym)", participant, { required: true })}
      <${Wearers} status=${status} people=${people} participant=${participant} act=${act} />
      ${box("session", "Session", fields.session, NAME)}
      ${box("task", "Task", fields.task, NAME)}
      ${box("folder", "Folder", fields.folder, { placeholder: recording.folder, title: fields.folder || recording.folder, size: Math.max(34, recording.folder.length + 2) })}
      <button class="main" data-clear disabled=${isUnderWay}>${isUnderWay || recording.busy !== "" ? OPENING : "Record"}</button>
      <label class="check"><input type="checkbox" checked=${fields.only_ours} onChange=${(event) => setFields({ only_ours: event.target.checked })} /> only these sensors, no streams of other programs</label>
      <label class="check"><input type="checkbox" checked=${isLax} onChange=${(event) => setLax({ isLax: event.target.checked })} /> even if streams are missing</label>
    </form>`;
}

export function Session({ status, act }) {
  const { recording } = status;
  return html`
    <section class="panel" aria-labelledby="session">
      <div class="card-head"><h2 id="session">Recording</h2><${Alarm} /></div>
      ${recording.is_running ? html`<${Running} recording=${recording} act=${act} />` : html`
        ${recording.file && !recording.verdict && html`
          <ul class="problems" role="alert">${recording.problems.map((each) => html`<li>${worded(each)}</li>`)}</ul>
          <button onClick=${() => act("POST", "/recording/stop")}>Close and check it</button>`}
        <${Begin} status=${status} act=${act} />`}
      ${!recording.is_running && recording.verdict && html`<${Verdict} verdict=${recording.verdict} act=${act} />`}
    </section>`;
}
