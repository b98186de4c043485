// What two computers have found out about the network between them, by direction.

import { html } from "../vendor/preact-htm.js";
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

export function Outcome({ outcome }) {
  const word = outcome.good ? "Streams get through in both directions." : "Something is blocking them; see below how to allow them.";
  return html`
    <p role="status">${word}</p>
    ${outcome.sides.map((each) => html`<p class="small soft file">${each}</p>`)}
    ${outcome.rows.length > 0 && html`<${Directions} rows=${outcome.rows} />`}
    <ul class="findings">${outcome.findings.map((each) => html`<${Finding} finding=${each} />`)}</ul>`;
}
