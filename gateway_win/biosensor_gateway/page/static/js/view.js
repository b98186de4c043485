// The page as other computers see it: everything is shown, and nothing can be changed.

import { html, render, useEffect, useRef, useState } from "../vendor/preact-htm.js";
import { Bar, useScrolledPast } from "./bar.js";
import { Cards } from "./cards.js";
import { Detail } from "./detail.js";
import { Live } from "./live.js";
import { MarkerList } from "./markers.js";
import { useOpen } from "./open.js";
import { State as Recording } from "./recording.js";
import { ReplayNotice } from "./replay.js";
import { Agent, Notices, useShown } from "./status.js";
import { useTitle } from "./title.js";

function View() {
  const [status, setStatus] = useState(undefined);
  const [open, setOpen] = useOpen();
  const live = useRef(null);
  useEffect(() => { live.current = new Live(setStatus); }, []);
  const { devices, device } = useShown(live, status, open);
  useTitle(status);
  const session = useRef(null);
  const isPast = useScrolledPast(session, Boolean(status) && !status.ended && !device);
  if (status === undefined) return html`<p class="wait">Opening …</p>`;
  if (!status || status.ended) {
    return html`<main><p class="panel problem" role="alert">The page on the other computer does not answer. Nothing shown here is current. It may have been ended there, or the network is cut.</p></main>`;
  }
  return html`
    <header>
      <h1>Biosensor Gateway <span class="soft small">view of another computer</span></h1>
      <${Agent} status=${status} />
    </header>
    <main>
      ${(device || isPast) && html`<${Bar} status=${status} isOver=${!device} />`}
      <${Notices} status=${status} />
      <${ReplayNotice} replay=${status.replay} />
      ${!device && html`
        <div class="pair">
          <section ref=${session} class="panel" aria-labelledby="session"><h2 id="session">Recording</h2><${Recording} recording=${status.recording} /></section>
          ${status.markers.markers.length > 0 && html`<section class="panel" aria-labelledby="markers"><h2 id="markers">Markers</h2><${MarkerList} markers=${status.markers} /></section>`}
        </div>`}
      ${device
        ? html`<${Detail} live=${live.current} device=${device} onClose=${() => setOpen(null)} />`
        : html`<${Cards} live=${live.current} devices=${devices} onOpen=${setOpen} />`}
    </main>`;
}

render(html`<${View} />`, document.getElementById("page"));
