// Plays a recording, and shows everywhere that it is not a live person.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { useKept } from "./kept.js";
import { useOneAtATime } from "./one_at_a_time.js";
import { clock } from "./words.js";

const OTHER = "other";

function size(bytes) {
  return bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

function when(seconds) {
  return new Date(1000 * seconds).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
}

function speedOf(replay) {
  return replay.speed === 1 ? "" : ` at ${replay.speed} times its speed`;
}

function place(replay) {
  if (!replay.is_playing) return replay.stream_count ? "about to start" : "opening the recording …";
  return `${clock(replay.position_s)} of ${clock(replay.length_s)}${replay.lap > 1 ? `, round ${replay.lap}` : ""}`;
}

// What came of it must not vanish by itself: nobody may have looked as it ended.
export function Over({ replay }) {
  const [{ read }, setRead] = useKept("replay-over", { read: "" });
  const told = replay.said.join(" ");
  if (!told || told === read) return null;
  return html`
    <section class="panel notice" aria-labelledby="replay-over">
      <div class="card-head">
        <h2 id="replay-over">The replay has ended</h2>
        <button onClick=${() => setRead({ read: told })}>Close<span class="hidden"> this notice</span></button>
      </div>
      <p class="file small">${replay.file}</p>
      <p class="small">${told}</p>
    </section>`;
}

// Above everything else while something is played.
export function ReplayNotice({ replay, act }) {
  const [isUnderWay, once] = useOneAtATime(act);
  if (!replay?.is_running) return null;
  return html`
    <section class="panel replay" aria-labelledby="replay-now">
      <div class="card-head">
        <h2 id="replay-now"><span aria-hidden="true">↻</span> Replay: a recording, not a person</h2>
        ${act && html`<button disabled=${isUnderWay} onClick=${() => once("POST", "/replay/stop")}>${isUnderWay ? "Ending …" : "End the replay"}</button>`}
      </div>
      <p class="file">${replay.file}${speedOf(replay)}</p>
      <progress max=${replay.length_s || 1} value=${replay.position_s} aria-label="Position in the recording"></progress>
      <p class="facts small">
        <span class="clock">${place(replay)}</span>
        ${replay.stream_count > 0 && html`<span>${replay.received} of ${replay.stream_count} streams received by a program</span>`}
      </p>
      <p class="small soft">It is sent as separate LSL streams, which tell their receivers that they are a replay. Its cards have the sign ↻.</p>
      ${replay.said.map((each) => html`<p class="reason small">${each}</p>`)}
    </section>`;
}

function Streams({ streams, chosen, onChoose }) {
  const toggle = (name) => (event) => {
    const next = new Set(chosen);
    if (event.target.checked) next.add(name);
    else next.delete(name);
    onChoose(next);
  };
  const names = [...new Set(streams.map((each) => each.name))];
  return html`
    <details><summary>Streams: ${chosen.size === names.length ? "all" : `${chosen.size} of ${names.length}`}</summary>
      <div class="buttons">
        <button type="button" class="plain small" onClick=${() => onChoose(new Set(names))}>all</button>
        <button type="button" class="plain small" onClick=${() => onChoose(new Set())}>none</button>
      </div>
      <ul class="streams small">${names.map((name) => html`
        <li key=${name}><label class="check"><input type="checkbox" checked=${chosen.has(name)} onChange=${toggle(name)} /> ${name}</label></li>`)}</ul>
    </details>`;
}

function Contents({ contents }) {
  const people = [...new Set(contents.streams.map((each) => each.wearer).filter(Boolean))];
  const count = contents.streams.length;
  return html`
    <p class="small" role="status">${clock(contents.length_s)} long, ${count === 1 ? "1 stream" : `${count} streams`}${people.length ? `, of ${people.join(", ")}` : ""}</p>
    ${contents.problems.map((each) => html`<p class="reason small">${each}</p>`)}`;
}

// Names are matched literally: * ? and [ have a meaning for users who choose by patterns.
const exactly = (name) => name.replace(/[*?[]/g, "[$&]");

export function Replay({ act, isRunning, onClose }) {
  const [files, setFiles] = useState(null);
  const [choice, setChoice] = useState("");
  const [typed, setTyped] = useState("");
  const [contents, setContents] = useState(null);
  const [chosen, setChosen] = useState(new Set());
  const [problem, setProblem] = useState("");
  const [fields, setFields] = useState({ begin: "", end: "", speed: "1" });
  const [checks, setChecks] = useState({ loop: false, beside_live: false });
  const [isUnderWay, once] = useOneAtATime(act);
  const path = choice === OTHER ? typed.trim() : choice;
  useEffect(() => {
    ask("GET", "/recordings").then((found) => {
      setFiles(found);
      setChoice(found[0]?.path ?? OTHER);
    }, (error) => setProblem(error.message));
  }, []);
  useEffect(() => {
    setContents(null);
    setProblem("");
    if (!path) return undefined;
    let isWanted = true;
    const look = async () => {
      try {
        const found = await ask("POST", "/recordings/contents", { path });
        if (!isWanted) return;
        setContents(found);
        setChosen(new Set(found.streams.map((each) => each.name)));
      } catch (error) {
        if (isWanted) setProblem(error.message);
      }
    };
    const timer = setTimeout(look, choice === OTHER ? 600 : 0);
    return () => { isWanted = false; clearTimeout(timer); };
  }, [path]);
  const isAll = contents && contents.streams.every((each) => chosen.has(each.name));
  const play = (event) => {
    event.preventDefault();
    const streams = isAll ? [] : [...chosen].map(exactly);
    once("POST", "/replay/start", { path, ...fields, speed: Number(fields.speed), streams, ...checks });
  };
  const set = (name) => (event) => setFields({ ...fields, [name]: event.target.value });
  const tick = (name) => (event) => setChecks({ ...checks, [name]: event.target.checked });
  return html`
    <section class="panel" aria-labelledby="replay">
      <div class="card-head">
        <h2 id="replay">Play a recording</h2>
        <div class="buttons"><button onClick=${onClose}>Close</button></div>
      </div>
      ${files && html`
        <form onSubmit=${play}>
          <label class="wide">Recording
            <select value=${choice} onChange=${(event) => setChoice(event.target.value)}>
              ${files.map((each) => html`<option key=${each.path} value=${each.path}>${each.name} (${when(each.modified)}, ${size(each.bytes)})</option>`)}
              <option value=${OTHER}>another file …</option>
            </select>
          </label>
          ${choice === OTHER && html`
            <label class="wide">Full path of an XDF file or a ROS bag
              <input type="text" required size="48" value=${typed} onInput=${(event) => setTyped(event.target.value)} />
            </label>`}
          <label>Speed
            <select value=${fields.speed} onChange=${set("speed")}>
              ${["0.5", "1", "2", "5", "10", "50"].map((each) => html`<option value=${each}>${each === "1" ? "as recorded" : `${each} times`}</option>`)}
            </select>
          </label>
          <label>From, as 1:30<input type="text" size="8" maxlength="40" placeholder="its start" value=${fields.begin} onInput=${set("begin")} /></label>
          <label>Until<input type="text" size="8" maxlength="40" placeholder="its end" value=${fields.end} onInput=${set("end")} /></label>
          <button class="main" disabled=${isUnderWay || isRunning || !contents || !chosen.size}>${isUnderWay ? "Opening …" : "Play"}</button>
          <label class="check"><input type="checkbox" checked=${checks.loop} onChange=${tick("loop")} /> repeat</label>
          <label class="check"><input type="checkbox" checked=${checks.beside_live} onChange=${tick("beside_live")} /> also alongside the real sensors</label>
        </form>`}
      ${problem && html`<p class="reason small" role="alert">${problem}</p>`}
      ${!contents && !problem && path && html`<p class="small soft" role="status">Reading the recording …</p>`}
      ${contents && html`<${Contents} contents=${contents} /><${Streams} streams=${contents.streams} chosen=${chosen} onChoose=${setChosen} />`}
    </section>`;
}
