// Recordings on the disk: whether they can be trusted, what is in them, and their way to other programs.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { Explained } from "./findings.js";
import { COLOURS } from "./recording.js";
import { clock, worded } from "./words.js";

const LOOK_MS = 500;
const OTHER = "other";
const MEANT = {
  bids: "BIDS: a data set of a study",
  csv: "CSV: tables for Excel, R, SPSS",
  "csv.gz": "CSV, packed",
  "csv-long": "CSV with one value per line",
  "csv-long.gz": "CSV with one value per line, packed",
  edf: "EDF+: EEG and sleep programs",
  kubios: "Kubios: heart rate variability",
  ledalab: "Ledalab: skin conductance",
  mcap: "MCAP: ROS and Foxglove",
};

function Judged({ judged }) {
  const [sign, tone] = COLOURS[judged.colour] ?? COLOURS.red;
  return html`
    <p class=${`state ${tone}`} role="status"><span aria-hidden="true">${sign}</span> ${judged.sentence}</p>
    <${Explained} findings=${judged.findings} />
    ${judged.unread && html`<p class="reason small">The markers cannot be shown: ${judged.unread}</p>`}
    ${!judged.unread && html`
      <details><summary>Markers: ${judged.marker_count || "none"}</summary>
        <ul class="small found-in-it" tabindex="0">${judged.markers.map((each) => html`<li><span class="clock">${clock(each.time_s)}</span> ${each.text}</li>`)}</ul>
        ${judged.marker_count > judged.markers.length && html`<p class="small reason">Only the first ${judged.markers.length} are shown.</p>`}
      </details>`}`;
}

const OUTCOMES = {
  whole: ["●", "good", "Everything is exported"],
  partial: ["◐", "warn", "Exported, but incomplete or uncertain: read below"],
  none: ["■", "bad", "No recording was exported"],
};

function Exported({ view, onEnd }) {
  const place = view.done.length + view.part;
  const isWhole = !view.problem && view.done.length === view.count && view.done.every((each) => each.is_certain);
  const outcome = (isCertain, isWritten) => OUTCOMES[isCertain ? "whole" : isWritten ? "partial" : "none"];
  const [sign, tone, word] = outcome(isWhole, view.done.some((each) => each.is_written));
  return html`
    ${view.is_running && html`
      <p role="status">Writing ${view.format} of ${view.recording || "the first recording"} …</p>
      <progress max=${view.count || 1} value=${place} aria-label="Export progress"></progress>
      ${view.count > 1 && html`<button onClick=${onEnd}>End after this recording</button>`}`}
    ${!view.is_running && view.count > 0 && html`
      <p class=${`state ${tone}`} role="status"><span aria-hidden="true">${sign}</span> ${word}</p>`}
    ${view.problem && html`<p class="reason" role="alert">${worded(view.problem)}</p>`}
    ${view.said.map((each) => html`<p class="reason small">${worded(each)}</p>`)}
    ${view.done.map((each) => {
      const [mark, shade] = outcome(each.is_certain, each.is_written);
      return html`
        <details key=${each.recording} open=${!each.is_certain || view.count === 1}><summary><span class=${`state ${shade}`}>${mark}</span> ${each.recording}</summary>
          <ul class="small">${each.said.map((said) => html`<li class="file">${worded(said)}</li>`)}</ul></details>`;
    })}`;
}

function Export({ path, isFile }) {
  const [formats, setFormats] = useState([]);
  const [chosen, setChosen] = useState(new Set(["csv"]));
  const [isFolder, setFolder] = useState(false);
  const [output, setOutput] = useState("");
  const [whose, setWhose] = useState("");
  const [view, setView] = useState(null);
  const [problem, setProblem] = useState("");
  const tell = async (method, content) => {
    try {
      setView(await ask(method, "/recordings/export", content));
      setProblem("");
    } catch (error) {
      setProblem(error.message);
    }
  };
  useEffect(() => {
    ask("GET", "/recordings/formats").then(setFormats, (error) => setProblem(error.message));
    tell("GET");
  }, []);
  useEffect(() => {
    if (!view?.is_running) return undefined;
    const timer = setInterval(() => tell("GET"), LOOK_MS);
    return () => clearInterval(timer);
  }, [view?.is_running]);
  const toggle = (name) => (event) => {
    const next = new Set(chosen);
    if (event.target.checked) next.add(name);
    else next.delete(name);
    setChosen(next);
  };
  const start = (event) => {
    event.preventDefault();
    const place = isFile && isFolder ? path.replace(/[\\/][^\\/]*$/, "") : path;
    tell("POST", { path: place, formats: [...chosen], output, whose: whose || null });
  };
  return html`
    <h3 id="export">Export</h3>
    <form onSubmit=${start} aria-labelledby="export">
      ${formats.map((each) => html`<label class="check"><input type="checkbox" checked=${chosen.has(each)} onChange=${toggle(each)} /> ${MEANT[each] ?? each}</label>`)}
      ${isFile && html`<label class="check alone"><input type="checkbox" checked=${isFolder} onChange=${(event) => setFolder(event.target.checked)} /> all recordings in its folder</label>`}
      <label class="wide">Save to this folder<input type="text" size="40" placeholder=${chosen.has("bids") && (isFolder || !isFile) ? "of one BIDS data set; if empty, each recording gets its own next to it" : "next to the recording"} value=${output} onInput=${(event) => setOutput(event.target.value)} /></label>
      <label class="wide">Participant, if file name and sensors differ
        <select value=${whose} onChange=${(event) => setWhose(event.target.value)}>
          <option value="">not decided</option>
          <option value="sensors">as the sensors say</option>
          <option value="name">as the file name says</option>
        </select>
      </label>
      <button class="main" disabled=${!path || !chosen.size || view?.is_running}>${view?.is_running ? "Exporting …" : "Export"}</button>
    </form>
    ${problem && html`<p class="reason small" role="alert">${worded(problem)}</p>`}
    ${view && html`<${Exported} view=${view} onEnd=${() => tell("DELETE")} />`}`;
}

export function Files({ act, onClose }) {
  const [files, setFiles] = useState(null);
  const [choice, setChoice] = useState("");
  const [typed, setTyped] = useState("");
  const [judged, setJudged] = useState(null);
  const [salvaged, setSalvaged] = useState(null);
  const [headerFrom, setHeaderFrom] = useState("");
  const [doing, setDoing] = useState("");
  const [problem, setProblem] = useState("");
  const path = choice === OTHER ? typed.trim() : choice;
  const list = () => ask("GET", "/recordings").then((found) => {
    setFiles(found);
    return found;
  });
  useEffect(() => {
    list().then((found) => setChoice(found[0]?.path ?? OTHER), (error) => setProblem(error.message));
  }, []);
  useEffect(() => { setJudged(null); setSalvaged(null); setHeaderFrom(""); setProblem(""); }, [path]);
  const look = async (what, take, more = {}) => {
    setDoing(what);
    setProblem("");
    try {
      take(await ask("POST", `/recordings/${what}`, { path, ...more }));
    } catch (error) {
      setProblem(error.message);
    }
    setDoing("");
  };
  // The new file is among those to choose from.
  const salvage = () => look("salvage", (told) => { setSalvaged(told); list().catch(() => {}); }, { header_from: headerFrom.trim() });
  return html`
    <section class="panel" aria-labelledby="files">
      <div class="card-head"><h2 id="files">Recordings</h2><div class="buttons"><button onClick=${onClose}>Close<span class="hidden"> the recordings</span></button></div></div>
      ${files && html`
        <form onSubmit=${(event) => event.preventDefault()}>
          <label class="wide">Recording
            <select value=${choice} disabled=${doing !== ""} onChange=${(event) => setChoice(event.target.value)}>
              ${files.map((each) => html`<option key=${each.path} value=${each.path}>${each.name}</option>`)}
              <option value=${OTHER}>another file or folder …</option>
            </select>
          </label>
          ${choice === OTHER && html`<label class="wide">Full path<input type="text" size="48" disabled=${doing !== ""} value=${typed} onInput=${(event) => setTyped(event.target.value)} /></label>`}
        </form>
        <div class="buttons">
          <button disabled=${!path || doing !== ""} onClick=${() => look("check", setJudged)}>${doing === "check" ? "Reading …" : "Check it"}</button>
          <button disabled=${!path} onClick=${() => act("POST", "/recordings/open-folder", { path })}>Open folder</button>
          ${judged?.can_be_salvaged && !salvaged && html`<button disabled=${doing !== ""} onClick=${salvage}>${doing === "salvage" ? "Salvaging …" : "Salvage it"}</button>`}
        </div>`}
      ${judged?.can_be_salvaged && !salvaged && html`<label class="wide">Headers from (the full path of another recording of the same streams, if headers are lost)<input type="text" size="48" placeholder="not needed otherwise" disabled=${doing !== ""} value=${headerFrom} onInput=${(event) => setHeaderFrom(event.target.value)} /></label>`}
      ${problem && html`<p class="reason small" role="alert">${worded(problem)}</p>`}
      ${judged && html`<${Judged} judged=${judged} />`}
      ${salvaged && html`<ul class="small" role="status">${salvaged.said.map((each) => html`<li class="file">${worded(each)}</li>`)}</ul>`}
      <${Export} path=${path} isFile=${/\.xdf(z|\.gz)?$/i.test(path)} />
    </section>`;
}
