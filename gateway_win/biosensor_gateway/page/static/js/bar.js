// A slim bar for every view: what is recorded, what is wrong with it, its end, and the markers.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { MarkerButtons } from "./markers.js";
import { useOneAtATime } from "./one_at_a_time.js";
import { COLOURS, OPENING } from "./recording.js";
import { clock } from "./words.js";

const NOTHING = ["○", "soft", "not recording"];
const ENDED = ["▲", "bad", "the recording ended unexpectedly"];

function standing(recording) {
  const { verdict } = recording;
  if (recording.is_running) {
    const [sign, tone, , words] = COLOURS[recording.colour] ?? COLOURS.red;
    return [sign, tone, words];
  }
  // Not yet "recording", but no longer what came of the one before.
  if (recording.busy) return ["◐", "soft", OPENING];
  if (!recording.file || verdict) return verdict ? [...(COLOURS[verdict.colour] ?? COLOURS.red).slice(0, 2), verdict.sentence] : NOTHING;
  return ENDED;
}

// Above a view that is without the panels; else it comes up when they were scrolled past.
export function Bar({ status, act, isOver }) {
  const { recording, markers } = status;
  const [isUnderWay, once] = useOneAtATime(act);
  const [sign, tone, words] = standing(recording);
  const said = [...recording.problems, ...recording.notes];
  const isOpen = recording.is_running || tone === ENDED[1];
  return html`
    <div class=${`bar-place ${isOver ? "over" : ""}`}>
      <section class="bar" aria-label="Current recording">
        <p class=${`state ${tone}`}><span aria-hidden="true">${sign}</span> ${words}</p>
        ${recording.is_running && html`<span class="clock">${clock(recording.elapsed_s)}</span>`}
        ${isOpen && said.length > 0 && html`<p class="small said" title=${said.join("\n")}>${said[0]}${said.length > 1 && ` (and ${said.length - 1} more)`}</p>`}
        ${act && recording.is_running && html`
          <button class="main" data-clear disabled=${isUnderWay} onClick=${() => once("POST", "/recording/stop")}>${recording.busy === "ending" ? "Ending and checking …" : html`Stop<span class="hidden"> the recording</span>`}</button>`}
        ${act && status.agent === "running" && html`<${MarkerButtons} names=${markers.buttons} act=${act} />`}
      </section>
    </div>`;
}

// Whether what a person looks for has left the screen at its upper edge.
export function useScrolledPast(place, isThere) {
  const [isPast, setPast] = useState(false);
  useEffect(() => {
    setPast(false);
    if (!place.current) return undefined;
    const observer = new IntersectionObserver(([entry]) => setPast(!entry.isIntersecting && entry.boundingClientRect.bottom <= 0));
    observer.observe(place.current);
    return () => observer.disconnect();
  }, [isThere]);
  return isPast && isThere;
}
