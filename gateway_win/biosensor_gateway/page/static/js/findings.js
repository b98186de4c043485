// What was found, how bad it is, why it matters and what fixes it.

import { html } from "../vendor/preact-htm.js";

const LEVELS = {
  error: ["▲", "bad", "error"],
  warning: ["◐", "warn", "warning"],
  note: ["i", "soft", "note"],
  ok: ["●", "good", "in order"],
};

export function Finding({ finding }) {
  const [sign, tone, word] = LEVELS[finding.level] ?? LEVELS.note;
  return html`
    <li>
      <p class="found-head"><span class="state ${tone}"><span aria-hidden="true">${sign}</span> ${word}</span> <strong>${finding.what}</strong></p>
      ${finding.why && html`<p class="small">${finding.why}</p>`}
      ${finding.fix && html`<pre class="fix" tabindex="0">${finding.fix}</pre>`}
    </li>`;
}
