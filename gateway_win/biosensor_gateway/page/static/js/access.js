// Secrets for vendors' services: written here, shown nowhere.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { ask } from "./api.js";

function Secret({ secret, act, onKept }) {
  const [text, setText] = useState("");
  const keep = async (event) => {
    event.preventDefault();
    if (await act("PUT", "/secrets", { sensor: secret.sensor, name: secret.name, text })) {
      setText("");
      onKept();
    }
  };
  return html`
    <form onSubmit=${keep}>
      <label>${secret.title[0].toUpperCase() + secret.title.slice(1)}
        <input type="password" autocomplete="off" required value=${text} onInput=${(event) => setText(event.target.value)} />
      </label>
      <button>Keep<span class="hidden"> ${secret.title}</span></button>
      <span class="small ${secret.where ? "soft" : "reason"}">${secret.where ? `known, ${secret.where}` : "missing"}</span>
    </form>`;
}

export function Access({ sensor, act }) {
  const [secrets, setSecrets] = useState([]);
  const look = () => ask("GET", "/secrets").then(setSecrets, () => {});
  useEffect(() => { look(); }, [sensor]);
  const own = secrets.filter((each) => each.sensor === sensor);
  if (!own.length) return null;
  return html`
    <h3>Access to the vendor's service</h3>
    ${own.map((secret) => html`<${Secret} key=${secret.name} secret=${secret} act=${act} onKept=${look} />`)}
    <p class="small soft">The system's keyring keeps what you enter. It is never shown again, and is not in any file of this program.</p>`;
}
