// Answers the network check of another computer: shows the code that is entered there, and what comes of it.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { Outcome } from "./directions.js";

const LOOK_MS = 500;
const PATH = "/network-check/answer";
const USUAL_PORT = 16827;

function Invitation({ answer }) {
  const port = answer.port === USUAL_PORT ? "" : ` --port ${answer.port}`;
  const typed = `--with ${answer.address}${port} --code ${answer.code}`;
  return html`
    <dl class="pairs">
      <dt>Address</dt><dd><code>${answer.address}</code></dd>
      <dt>Code</dt><dd><code class="code">${answer.code}</code></dd>
      ${port && html`<dt>Port</dt><dd><code>${answer.port}</code></dd>`}
    </dl>
    <p class="small">Enter them on the other computer, on its page under <em>Check this computer</em>, or type there: <code>biosensor-gateway doctor ${typed}</code>; where the node is: <code>python3 -m lsl_to_ros.doctor ${typed}</code></p>
    ${answer.others.length > 0 && html`<p class="small soft">This computer's other addresses: ${answer.others.join(", ")}</p>`}
    <details><summary class="small">The other computer reports that nothing comes back</summary><p class="small">Open the port here:</p><pre class="small">${answer.opening}</pre></details>`;
}

export function Answer() {
  const [answer, setAnswer] = useState(null);
  const [problem, setProblem] = useState("");
  const isOn = answer?.state === "waiting" || answer?.state === "trying";
  const tell = async (method) => {
    try {
      setAnswer(await ask(method, PATH));
      setProblem("");
    } catch (error) {
      setProblem(error.message);
    }
  };
  // It may have been started in another window.
  useEffect(() => { tell("GET"); }, []);
  useEffect(() => {
    if (!isOn) return undefined;
    const timer = setInterval(() => tell("GET"), LOOK_MS);
    return () => clearInterval(timer);
  }, [isOn]);
  if (!answer) return problem && html`<p class="reason" role="alert">${problem}</p>`;
  const word = { waiting: "For ten minutes, this computer answers any computer that knows the code.", trying: "Another computer is connected. Both are testing the network, for about 15 s …" }[answer.state];
  return html`
    <div class="answer" role="group" aria-label="Answer another computer">
      ${isOn
        ? html`<button onClick=${() => tell("DELETE")} disabled=${answer.state === "trying"}>Stop answering</button>`
        : html`<button onClick=${() => tell("POST")}>Answer another computer</button>`}
      ${isOn && html`<p role="status">${word}</p>`}
      ${answer.state === "waiting" && html`<${Invitation} answer=${answer} />`}
      ${isOn && answer.said.map((each) => html`<p class="reason small">${each}</p>`)}
      ${answer.state === "ended" && html`<p role="status">${answer.problem}</p>`}
      ${problem && html`<p class="reason" role="alert">${problem}</p>`}
      ${answer.outcome && html`<${Outcome} outcome=${answer.outcome} />`}
    </div>`;
}
