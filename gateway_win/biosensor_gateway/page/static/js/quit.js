// Quit: asks what becomes of streams and of a recording, and says at the end that it is over.

import { html, useEffect, useRef, useState } from "../vendor/preact-htm.js";

function goesOn(status) {
  const count = status.devices.length;
  const agent = status.agent === "starting"
    ? "The agent is starting."
    : `The agent streams from ${count === 1 ? "one sensor" : `${count} sensors`}.`;
  return [
    status.agent !== "absent" && agent,
    status.recording.is_running && `A recording is running: ${status.recording.file}`,
    status.replay.is_running && `A replay is running and ends with the page: ${status.replay.file}`,
  ].filter(Boolean);
}

export function Quit({ status, act }) {
  const dialog = useRef(null);
  const [busy, setBusy] = useState("");
  const running = goesOn(status);
  const quit = async (rest) => {
    setBusy(rest);
    if (!(await act("POST", "/quit", { rest }))) setBusy("");
    dialog.current?.close();
  };
  const ask = () => (running.length ? dialog.current.showModal() : quit("leave"));
  const everything = status.recording.is_running ? "Close the recording and end everything" : "End everything";
  return html`
    <button onClick=${ask} disabled=${busy !== ""}>Quit</button>
    <dialog ref=${dialog} aria-labelledby="quit" onCancel=${(event) => busy && event.preventDefault()}>
      <h2 id="quit">What do you want to end?</h2>
      ${running.map((sentence) => html`<p class="file">${sentence}</p>`)}
      <div class="choices">
        <button class="main" disabled=${busy !== ""} onClick=${() => quit("leave")}>Close only the page</button>
        <p class="small soft">Streams and recordings continue without it. Open it again whenever you like.</p>
        <button disabled=${busy !== ""} onClick=${() => quit("end")}>${busy === "end" ? "Ending …" : everything}</button>
        <p class="small soft">Every stream ends, including those that LabRecorder and the robot receive.</p>
        <button disabled=${busy !== ""} onClick=${() => dialog.current.close()}>Go back</button>
      </div>
    </dialog>`;
}

export function Ended({ told }) {
  // What came of the recording must not vanish as other news does.
  const [last, setLast] = useState(told);
  useEffect(() => { if (told) setLast(told); }, [told]);
  return html`
    <main>
      <section class="panel notice" role="status">
        <h1>The page has ended</h1>
        ${last?.text && html`<p class="file">${last.text}</p>`}
        <p>You can close this window. To open the page again: on Windows <i>Biosensor Gateway</i> in the Start menu, elsewhere the command <code>biosensor-gateway page</code>.</p>
      </section>
    </main>`;
}
