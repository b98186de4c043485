// Draws what was not passed on as it came, or was guessed.

import { html } from "../vendor/preact-htm.js";

const SHOWN = 3;

export function sentenceOf({ sentence, count, now }) {
  const isCounted = count < 2 || new RegExp(`\\b${count}\\b`).test(sentence);
  return `${sentence}${isCounted ? "" : ` (${count} times)`}${now ? "" : " (not lately)"}`;
}

function Item({ each }) {
  return html`<li class=${each.now ? "" : "soft"}><span class="state ${each.level === "error" ? "bad" : each.now ? "warn" : "soft"}" aria-hidden="true">${each.level === "error" ? "▲" : "◐"}</span> ${sentenceOf(each)}</li>`;
}

// On a card: what holds now, or was within the last seconds.
export function Refused({ refusals, most = SHOWN }) {
  const now = refusals.filter((each) => each.now);
  if (!now.length) return null;
  const more = now.length - most;
  return html`
    <ul class="refused small" aria-label="Data not passed on unchanged">
      ${now.slice(0, most).map((each) => html`<${Item} each=${each} />`)}
      ${more > 0 && html`<li class="soft">and ${more} more, in the details</li>`}
    </ul>`;
}

// In the details: everything since the agent's start.
export function AllRefused({ refusals }) {
  if (!refusals.length) return null;
  return html`
    <h3>Data not passed on unchanged</h3>
    <ul class="refused small">${[...refusals].sort((a, b) => b.now - a.now).map((each) => html`<${Item} each=${each} />`)}</ul>`;
}
