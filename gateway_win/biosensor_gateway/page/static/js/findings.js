// What was found, of a computer or in a recording: how bad it is, why it matters and what to do.

import { html } from "../vendor/preact-htm.js";
import { worded } from "./words.js";

const LEVELS = {
  error: ["▲", "bad", "error"],
  warning: ["◐", "warn", "warning"],
  note: ["i", "soft", "note"],
  ok: ["●", "good", "in order"],
};

const ABOUT = [["persons", "Participants' data"], ["others", "Streams of other programs"], ["ourselves", "The program's notes about itself"]];
const IN_A_RECORDING = { error: ["▲", "bad", "wrong or missing"], warning: ["◐", "warn", "must be considered"], note: ["i", "soft", "good to know"] };

// What was found in a recording, by what it is about, each with its words explained.
export function Explained({ findings }) {
  return ABOUT.map(([about, title]) => {
    const found = findings.filter((each) => each.about === about);
    return found.length > 0 && html`<h3>${title}</h3><ul class="found">${found.map((each) => html`<${InARecording} finding=${each} />`)}</ul>`;
  });
}

function InARecording({ finding }) {
  const [sign, tone, word] = IN_A_RECORDING[finding.level] ?? IN_A_RECORDING.error;
  return html`
    <li>
      <span class=${`state ${tone}`}><span aria-hidden="true">${sign}</span> ${word}:</span> ${worded(finding.text)}
      ${finding.consequences?.length > 0 && html`<details class="small"><summary>Because of that (${finding.consequences.length})</summary><ul>${finding.consequences.map((each) => html`<li>${worded(each)}</li>`)}</ul></details>`}
      ${finding.means && html`<details class="small"><summary>What it means, and what to do</summary><p>${worded(finding.means)}</p><p>${worded(finding.to_do)}</p></details>`}
    </li>`;
}

export function Finding({ finding }) {
  const [sign, tone, word] = LEVELS[finding.level] ?? LEVELS.note;
  return html`
    <li>
      <p class="found-head"><span class="state ${tone}"><span aria-hidden="true">${sign}</span> ${word}</span> <strong>${finding.what}</strong></p>
      ${finding.why && html`<p class="small">${finding.why}</p>`}
      ${finding.fix && html`<pre class="fix" tabindex="0">${finding.fix}</pre>`}
    </li>`;
}
