// What is wrong on this computer, why it matters, and what fixes it.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";
import { Finding } from "./findings.js";
import { NetworkCheck } from "./network.js";

function sentence(outcome) {
  const { error: errors, warning: warnings } = outcome.counts;
  if (!errors && !warnings) return "Nothing is wrong with this computer.";
  const named = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
  return `${[errors && named(errors, "error"), warnings && named(warnings, "warning")].filter(Boolean).join(" and ")}; below each is how to fix it.`;
}

export function Doctor({ onClose }) {
  const [outcome, setOutcome] = useState(null);
  const [problem, setProblem] = useState("");
  const [isRunning, setRunning] = useState(false);
  const examine = async () => {
    setRunning(true);
    setProblem("");
    try {
      setOutcome(await ask("POST", "/doctor"));
    } catch (error) {
      setProblem(error.message);
    }
    setRunning(false);
  };
  useEffect(() => { examine(); }, []);
  // The worst first.
  const bad = ["error", "warning", "note"].flatMap((level) => outcome?.findings.filter((each) => each.level === level) ?? []);
  const good = outcome?.findings.filter((each) => each.level === "ok") ?? [];
  return html`
    <section class="panel" aria-labelledby="doctor">
      <div class="card-head">
        <h2 id="doctor">Check of this computer</h2>
        <div class="buttons">
          <button onClick=${examine} disabled=${isRunning}>Check again</button>
          <button onClick=${onClose}>Close</button>
        </div>
      </div>
      <p role="status">${isRunning ? "Looking at Bluetooth, network, firewall, clock, power and settings …" : outcome && sentence(outcome)}</p>
      ${problem && html`<p class="reason" role="alert">${problem}</p>`}
      ${!isRunning && html`<ul class="findings">${bad.map((each) => html`<${Finding} finding=${each} />`)}</ul>`}
      ${!isRunning && good.length > 0 && html`
        <details><summary>Passed checks (${good.length})</summary>
          <ul class="findings">${good.map((each) => html`<${Finding} finding=${each} />`)}</ul>
        </details>`}
    </section>
    <${NetworkCheck} />`;
}
