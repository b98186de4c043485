// The page: what the server tells twice a second, and what a person does with it.

import { html, render, useEffect, useRef, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { Cards, mainStreams } from "./cards.js";
import { Detail } from "./detail.js";
import { Doctor } from "./doctor.js";
import { Live } from "./live.js";
import { Markers } from "./markers.js";
import { Ended, Quit } from "./quit.js";
import { Session } from "./recording.js";
import { Setup } from "./setup.js";

const WINDOW_S = 10;
const SPARK_PIXELS = 300;
const PLOT_PIXELS = 900;
const TOLD_MS = 8000;

const AGENT = {
  running: ["●", "good", "streaming agent runs"],
  starting: ["◌", "warn", "agent is starting"],
  absent: ["■", "bad", "agent does not run"],
};

function Agent({ status }) {
  const [sign, tone, word] = status ? AGENT[status.agent] : ["■", "bad", "the page's program does not answer"];
  return html`<span class="state ${tone}" role="status"><span aria-hidden="true">${sign}</span> ${word}</span>`;
}

function Head({ status, act, onSetup, onDoctor }) {
  const isHere = status?.agent === "running";
  const isAway = status?.agent === "absent";
  const end = () => {
    if (confirm("End the agent? Every stream ends, and a recording has a gap from here on.")) act("POST", "/agent/stop");
  };
  return html`
    <header>
      <h1>Biosensor Gateway</h1>
      <${Agent} status=${status} />
      <div class="buttons">
        ${isAway && status.configured > 0 && html`<button class="main" onClick=${() => act("POST", "/agent/start")}>Start streaming</button>`}
        ${isHere && html`<button onClick=${end}>End the agent</button>`}
        ${!status?.virtual && html`<button onClick=${onSetup}>Find sensors</button>`}
        ${status && html`<button onClick=${onDoctor}>Check this computer</button>`}
        ${status && html`<${Quit} status=${status} act=${act} />`}
      </div>
    </header>`;
}

function Welcome({ act, onSetup }) {
  return html`
    <section class="panel notice">
      <h2>No sensor is set up yet</h2>
      <p>Put your sensors on and switch them on. The program finds them, and you choose which are yours.</p>
      <div class="buttons">
        <button class="main" onClick=${onSetup}>Find sensors</button>
        <button onClick=${() => act("POST", "/agent/try")}>Try it with virtual sensors</button>
      </div>
    </section>`;
}

function Notices({ status }) {
  return html`
    ${status.problem && html`<section class="panel problem" role="alert"><h2>The settings file has a mistake</h2><p>${status.problem}</p><p class="small soft">Until it is mended, the agent goes on with what it had.</p></section>`}
    ${status.virtual && html`<p class="panel notice">These are virtual sensors: their signals are made up or were recorded.</p>`}
    ${status.restarts > 0 && html`<p class="panel notice">The agent had died (${status.last_end}) and was started again. What it could not send then is a gap in every stream.</p>`}
    ${status.skipped > 0 && html`<p class="panel notice small">This page was too slow for ${status.skipped} samples, and left them out of its traces. Streams and recordings have them.</p>`}`;
}

function App() {
  const [status, setStatus] = useState(undefined);
  const [open, setOpen] = useState(null);
  const [isSetup, setSetup] = useState(false);
  const [isExamined, setExamined] = useState(false);
  const [told, setTold] = useState(null);
  const live = useRef(null);
  useEffect(() => {
    live.current = new Live(setStatus);
    window.biosensorLive = live.current;
  }, []);
  useEffect(() => {
    // What was refused stays until it was read.
    if (!told || told.isProblem) return undefined;
    const timer = setTimeout(() => setTold(null), TOLD_MS);
    return () => clearTimeout(timer);
  }, [told]);

  const devices = status?.devices ?? [];
  const device = devices.find((each) => each.name === open);
  useEffect(() => {
    if (!live.current || !status) return;
    const shown = device ? device.streams : devices.flatMap(mainStreams);
    live.current.show(shown.map((each) => each.source_id), WINDOW_S, device ? PLOT_PIXELS : SPARK_PIXELS);
  }, [status]);

  // Answers with whether it is done; what was refused is told in the server's words.
  const act = async (method, path, content) => {
    try {
      setTold({ text: (await ask(method, path, content)).sentence });
      return true;
    } catch (error) {
      setTold({ text: error.message, isProblem: true });
      return false;
    }
  };

  if (status?.ended) return html`<${Ended} told=${told} />`;
  if (status === undefined) return html`<p class="wait">Opening …</p>`;
  const isEmpty = status && !status.devices.length && !status.configured && status.agent !== "starting";
  return html`
    <${Head} status=${status} act=${act} onSetup=${() => setSetup(true)} onDoctor=${() => setExamined(true)} />
    <main>
      ${status && html`<${Notices} status=${status} />`}
      ${!status && html`<p class="panel problem" role="alert">The page's program does not answer. Nothing here is of now. If it was ended, start it again: biosensor-gateway page.</p>`}
      ${isSetup && html`<${Setup} act=${act} configured=${status?.configured} onClose=${() => setSetup(false)} />`}
      ${isExamined && html`<${Doctor} onClose=${() => setExamined(false)} />`}
      ${isEmpty && !isSetup && html`<${Welcome} act=${act} onSetup=${() => setSetup(true)} />`}
      ${status && !isEmpty && !device && html`
        <div class="pair">
          <${Session} recording=${status.recording} act=${act} />
          ${status.agent === "running" && html`<${Markers} markers=${status.markers} act=${act} />`}
        </div>`}
      ${device
        ? html`<${Detail} live=${live.current} device=${device} isVirtual=${status.virtual} act=${act} onClose=${() => setOpen(null)} />`
        : html`<${Cards} live=${live.current} devices=${devices} onOpen=${setOpen} />`}
    </main>
    <footer class="small">${status?.settings_file && html`Settings: ${status.settings_file}`}</footer>
    <div aria-live="polite">${told && html`
      <p class="toast">${told.text} ${told.isProblem && html`<button onClick=${() => setTold(null)}>Close</button>`}</p>`}</div>`;
}

render(html`<${App} />`, document.getElementById("page"));
