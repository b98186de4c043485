// The network to another computer, tried from both sides: which one blocks what, and what opens it.

import { html, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { Finding } from "./findings.js";

const TONES = { yes: "good", NO: "bad", PART: "bad" };

function Directions({ rows }) {
  const [headings, ...lines] = rows;
  return html`
    <div class="scroll" tabindex="0" role="group" aria-label="What gets through, by direction">
      <table class="small">
        <thead><tr>${headings.map((each) => html`<th scope="col">${each || "What"}</th>`)}</tr></thead>
        <tbody>${lines.map(([label, ...cells]) => html`
          <tr><th scope="row">${label}</th>${cells.map((each) => html`<td class="state ${TONES[each] ?? ""}">${each}</td>`)}</tr>`)}
        </tbody>
      </table>
    </div>`;
}

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
  const word = outcome?.is_good ? "Streams get through in both directions." : "Something is in the way; what opens it stands below.";
  return html`
    <section class="panel" aria-labelledby="network">
      <h2 id="network">Network to another computer</h2>
      <p class="small">Streams do not show up there, or those from there not here? Type there: <code>biosensor-gateway doctor --answer</code>, or where the node is: <code>python3 -m lsl_to_ros.doctor --answer</code>. It shows its address and a code. Then both try the network together.</p>
      <form onSubmit=${check}>
        <label>Address of that computer
          <input type="text" maxlength="253" required value=${fields.host} onInput=${set("host")} />
        </label>
        <label>Code
          <input type="text" maxlength="16" inputmode="numeric" autocomplete="off" required value=${fields.code} onInput=${set("code")} />
        </label>
        <button disabled=${isRunning}>Try the network</button>
      </form>
      <p role="status">${isRunning ? "Both computers try the network, for about 15 s …" : outcome && word}</p>
      ${problem && html`<p class="reason" role="alert">${problem}</p>`}
      ${outcome && html`
        ${outcome.sides.map((each) => html`<p class="small soft file">${each}</p>`)}
        ${outcome.rows.length > 0 && html`<${Directions} rows=${outcome.rows} />`}
        <ul class="findings">${outcome.findings.map((each) => html`<${Finding} finding=${each} />`)}</ul>`}
    </section>`;
}
