// Where other computers look on.

import { html } from "../vendor/preact-htm.js";
import { Copied } from "./detail.js";

export function Share({ share }) {
  return html`
    <details class="panel notice">
      <summary>Other computers can view this page</summary>
      <p class="small">They see devices, traces and the recording, and cannot change anything. Anyone with the address can view the page until it ends.</p>
      <ul class="small">${share.addresses.map((address) => html`<li><${Copied} text=${address} /></li>`)}</ul>
      <p class="small">The browser there asks about the certificate the first time. It is this computer's if its SHA-256 fingerprint is:</p>
      <p class="small file"><code>${share.fingerprint}</code></p>
    </details>`;
}
