// The network to another computer, tried from both sides: which one blocks what, and what opens it.

import { html, useState } from "../vendor/preact-htm.js";
import { Answer } from "./answer.js";
import { ask } from "./api.js";
import { Outcome } from "./directions.js";

export function NetworkCheck() {
  const [fields, setFields] = useState({ host: "", code: "" });
  const [outcome, setOutcome] = useState(null);
  const [problem, setProblem] = useState("");
  const [isRunning, setRunning] = useState(false);
  const set = (name) => (event) => setFields({ ...fields, [name]: event.target.value });
  const check = async (event) => {
    event.preventDefault();
    setRunning(true);
    setProblem("");
    setOutcome(null);
    try {
      setOutcome(await ask("POST", "/network-check", { host: fields.host.trim(), code: fields.code.trim() }));
    } catch (error) {
      setProblem(error.message);
    }
    setRunning(false);
  };
  return html`
    <section class="panel" aria-labelledby="network">
      <h2 id="network">Network to another computer</h2>
      <p class="small">Do streams not appear there, or those from there not here? The two computers test the network together: one answers and shows its address and a code, which you enter on the other. There, open this page and press <em>Answer another computer</em>, or type <code>biosensor-gateway doctor --answer</code>; where the node is, <code>python3 -m lsl_to_ros.doctor --answer</code>.</p>
      <form onSubmit=${check}>
        <label>Address of that computer
          <input type="text" maxlength="253" required value=${fields.host} onInput=${set("host")} />
        </label>
        <label>Code
          <input type="text" maxlength="16" inputmode="numeric" autocomplete="off" required value=${fields.code} onInput=${set("code")} />
        </label>
        <button disabled=${isRunning}>Test the network</button>
      </form>
      ${isRunning && html`<p role="status">Both computers are testing the network, for about 15 s …</p>`}
      ${problem && html`<p class="reason" role="alert">${problem}</p>`}
      ${outcome && html`<${Outcome} outcome=${outcome} />`}
      <${Answer} />
    </section>`;
}
