// The page: what the server tells twice a second, and what a person does with it.

import { html, render, useEffect, useRef, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { Bar, useScrolledPast } from "./bar.js";
import { Capture } from "./capture.js";
import { Cards } from "./cards.js";
import { Detail } from "./detail.js";
import { Doctor } from "./doctor.js";
import { Files } from "./files.js";
import { Live } from "./live.js";
import { Markers, useMarkerKeys } from "./markers.js";
import { useOpen } from "./open.js";
import { Question } from "./question.js";
import { Ended, Quit } from "./quit.js";
import { Session } from "./recording.js";
import { Over, Replay, ReplayNotice } from "./replay.js";
import { Setup } from "./setup.js";
import { Share } from "./share.js";
import { Agent, Notices, useShown } from "./status.js";
import { useTitle } from "./title.js";
import { Toast } from "./toast.js";

const TOLD_MS = 8000;
const LATE_MS = 400;

function Head({ status, act, onSetup, onReplay, onFiles, onDoctor }) {
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
        ${status && html`<button onClick=${onReplay}>Play a recording</button>`}
        ${status && html`<button onClick=${onFiles}>Recordings</button>`}
        ${status && html`<button onClick=${onDoctor}>Check this computer</button>`}
        ${status && html`<${Quit} status=${status} act=${act} />`}
      </div>
    </header>`;
}

function Welcome({ act, onSetup, onReplay }) {
  return html`
    <section class="panel notice">
      <h2>No sensor is set up yet</h2>
      <p>Put your sensors on and switch them on. The program finds them, and you choose which are yours.</p>
      <div class="buttons">
        <button class="main" onClick=${onSetup}>Find sensors</button>
        <button onClick=${() => act("POST", "/agent/try")}>Try it with virtual sensors</button>
        <button onClick=${onReplay}>Play a recording</button>
      </div>
    </section>`;
}

// Whether there is something to record, or was.
function isKept(status) {
  return Boolean(status) && (status.agent === "running" || status.recording.is_running || status.recording.file !== "" || Boolean(status.recording.verdict));
}

function App() {
  const [status, setStatus] = useState(undefined);
  const [open, setOpen] = useOpen();
  const [isSetup, setSetup] = useState(false);
  const [isReplay, setReplay] = useState(false);
  const [isFiles, setFiles] = useState(false);
  const [isExamined, setExamined] = useState(false);
  // A device that was chosen for it, or none yet.
  const [capture, setCapture] = useState(null);
  const [told, setTold] = useState(null);
  const [question, setQuestion] = useState(null);
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

  const { devices, device } = useShown(live, status, open);

  // Answers with whether it is done; what was refused is told in the server's words.
  const act = async (method, path, content) => {
    // Just after its start the page's program is still loading what carries it out.
    const late = setTimeout(() => setTold({ text: "One moment …" }), LATE_MS);
    try {
      setTold({ text: (await ask(method, path, content)).sentence });
      return true;
    } catch (error) {
      if (error.question) {
        clearTimeout(late);
        setTold(null);
        const more = await new Promise((answer) => setQuestion({ ...error.question, answer }));
        setQuestion(null);
        return more !== null && await act(method, path, { ...content, ...more });
      }
      setTold({ text: error.message, isProblem: true });
      return false;
    } finally {
      clearTimeout(late);
    }
  };

  useTitle(status);
  // While something is recorded, a key that marks nothing because the agent is away is answered so.
  useMarkerKeys(status?.agent === "running" || status?.recording?.is_running ? status.markers.buttons : [], act);
  const session = useRef(null);
  // Then the recording has no panel on the screen, or one that is somewhere below.
  const isElsewhere = Boolean(device) || isSetup || isReplay || isFiles || isExamined || Boolean(capture);
  const isPast = useScrolledPast(session, Boolean(status) && !isElsewhere);

  const choose = (chosen) => {
    setOpen(null);
    setCapture({ device: chosen, key: chosen ? `${chosen.sensor}/${chosen.unit ?? chosen.name}` : "" });
    window.scrollTo(0, 0);
  };
  if (status?.ended) return html`<${Ended} told=${told} />`;
  if (status === undefined) return html`<p class="wait">Opening …</p>`;
  const isEmpty = status && !status.devices.length && !status.configured && status.agent !== "starting" && !status.experiments && !status.replay.is_running;
  return html`
    <${Head} status=${status} act=${act} onSetup=${() => setSetup(true)} onReplay=${() => setReplay(true)} onFiles=${() => setFiles(true)} onDoctor=${() => setExamined(true)} />
    <main>
      ${isKept(status) && (isElsewhere || isPast) && html`<${Bar} status=${status} act=${act} isOver=${!isElsewhere} />`}
      ${status && html`<${Notices} status=${status} />`}
      ${status && html`<${ReplayNotice} replay=${status.replay} act=${act} />`}
      ${status?.share && html`<${Share} share=${status.share} />`}
      ${!status && html`<p class="panel problem" role="alert">The page's program does not answer. Nothing shown here is current. If it was ended, start it again: biosensor-gateway page.</p>`}
      ${capture && html`<${Capture} key=${capture.key} act=${act} chosen=${capture.device} onSetup=${() => setSetup(true)} onClose=${() => setCapture(null)} />`}
      ${isSetup && html`<${Setup} act=${act} configured=${status?.configured} onCapture=${choose} onClose=${() => setSetup(false)} />`}
      ${isReplay && status && html`<${Replay} act=${act} isRunning=${status.replay.is_running} onClose=${() => setReplay(false)} />`}
      ${isFiles && html`<${Files} act=${act} onClose=${() => setFiles(false)} />`}
      ${isExamined && html`<${Doctor} onClose=${() => setExamined(false)} />`}
      ${isEmpty && !isSetup && !isReplay && !isFiles && html`<${Welcome} act=${act} onSetup=${() => setSetup(true)} onReplay=${() => setReplay(true)} />`}
      ${status && (!isEmpty || isKept(status)) && !device && html`
        <div class="pair">
          <div><span ref=${session}></span><${Session} status=${status} act=${act} /></div>
          ${status.agent === "running" && html`<${Markers} markers=${status.markers} experiments=${status.experiments} isRecorded=${status.recording.is_running && status.recording.busy !== "ending"} isVirtual=${status.virtual} act=${act} />`}
        </div>`}
      ${status && !status.replay.is_running && html`<${Over} replay=${status.replay} />`}
      ${device
        ? html`<${Detail} live=${live.current} device=${device} isVirtual=${status.virtual} act=${device.replay ? undefined : act} onCapture=${choose} onClose=${() => setOpen(null)} />`
        : html`<${Cards} live=${live.current} devices=${devices} onOpen=${setOpen} />`}
    </main>
    <footer class="small">
      ${status?.settings_file && (status.virtual ? html`Virtual sensors; those of the settings are not used: ${status.settings_file}` : html`Settings: ${status.settings_file}`)}
      ${status && !status.virtual && !capture && html`<button class="plain" onClick=${() => choose(undefined)}>Help us: capture a device</button>`}
    </footer>
    ${question && html`<${Question} question=${question} />`}
    <div aria-live="polite">${told && html`<${Toast} told=${told} onClose=${() => setTold(null)} />`}</div>`;
}

render(html`<${App} />`, document.getElementById("page"));
