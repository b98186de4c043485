// Markers of the experimenter: a button or key for each name of the settings, notes, and undo;
// and those of web experiments.

import { html, useEffect } from "../vendor/preact-htm.js";
import { useKept } from "./kept.js";

const KEYS = 9;
// Neither a box that was ticked nor a list that was chosen from, which keep the focus.
const TYPED_INTO = "input:not([type=checkbox], [type=radio]), textarea";

function isTyping(event) {
  return event.target.closest?.(TYPED_INTO) || event.ctrlKey || event.altKey || event.metaKey;
}

function said({ kind, marker, note }) {
  return kind === "web" && note ? `${marker}: ${note}` : note || marker;
}

function within(seconds) {
  return seconds == null ? "" : `, to within ${(1000 * seconds).toFixed(1)} ms`;
}

function when({ time }) {
  if (!time) return "";
  const at = new Date(1000 * time);
  return html`<time datetime=${at.toISOString()}>${at.toLocaleTimeString()}</time>`;
}

const marking = (act) => (marker) => act("POST", "/markers", { marker, kind: "button" });

// The keys 1 to 9, in whatever view.
export function useMarkerKeys(names, act) {
  useEffect(() => {
    const press = (event) => {
      const name = names[Number(event.key) - 1];
      if (!name || isTyping(event) || event.repeat) return;
      // A list would choose what begins with this digit.
      event.preventDefault();
      marking(act)(name);
    };
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  }, [names.join("\n")]);
}

export function MarkerButtons({ names, act }) {
  return html`
    <div class="buttons" data-clear>
      ${names.map((name, index) => html`
        <button key=${name} onClick=${() => marking(act)(name)}>${name}${index < KEYS && html` <kbd aria-label=${`key ${index + 1}`}>${index + 1}</kbd>`}</button>`)}
    </div>`;
}

function Entries({ entries, undo }) {
  return html`
    <ol class="marks small" reversed>
      ${entries.map((each) => html`
        <li key=${`${each.id} ${each.lsl_time}`} class=${each.undone ? "undone" : ""}>
          ${when(each)} ${said(each)}${each.kind === "web" && html`<span class="soft"> from ${each.source}${within(each.uncertainty_s)}</span>`}${!each.received && html` <span class="warned">received by nobody</span>`}${each.undone ? " (marked as a mistake)" : undo && each.can_be_undone && html` <button class="plain" onClick=${() => undo(each.id)}>undo<span class="hidden"> ${said(each)}</span></button>`}
        </li>`)}
    </ol>`;
}

// Those of the recording that goes on, or that was the last; what was before is of somebody else.
export function MarkerList({ markers, undo }) {
  const shown = markers.markers.filter((each) => each.kind !== "undo").reverse();
  const earlier = shown.filter((each) => each.earlier);
  const own = shown.filter((each) => !each.earlier);
  return html`
    ${own.length > 0 && html`<${Entries} entries=${own} undo=${undo} />`}
    ${earlier.length > 0 && html`<details class="small"><summary>Before this recording (${earlier.length})</summary><${Entries} entries=${earlier} /></details>`}`;
}

function NameButtons({ names, act }) {
  // While the agent is away, there is no panel, and what was typed must not be lost by that.
  const [{ text }, keep] = useKept("buttons", { text: null });
  const setText = (typed) => keep({ text: typed });
  if (text === null) return html`<button class="plain small" onClick=${() => setText(names.join("\n"))}>Name the buttons …</button>`;
  const save = async (event) => {
    event.preventDefault();
    const buttons = text.split("\n").map((each) => each.trim()).filter(Boolean);
    if (await act("PUT", "/markers/buttons", { buttons })) setText(null);
  };
  return html`
    <form onSubmit=${save}>
      <label>Names of the buttons, one per line; the first nine have the keys 1 to 9
        <textarea rows="5" cols="30" value=${text} onInput=${(event) => setText(event.target.value)}></textarea>
      </label>
      <div class="buttons"><button>Save</button><button type="button" onClick=${() => setText(null)}>Go back</button></div>
    </form>`;
}

function Experiments({ experiments }) {
  const { problem, connected, origins, foreign } = experiments;
  return html`
    <h3 id="experiments">Web experiments</h3>
    ${problem && html`<p class="reason" role="alert">${problem}</p>`}
    ${!problem && html`
      <ul class="small plain-list" aria-labelledby="experiments">
        ${connected.map((each) => html`<li><span class="state good"><span aria-hidden="true">●</span> connected</span>: ${each.origin}${each.uncertainty_s == null ? ", its clock is being measured" : `, its clock is known${within(each.uncertainty_s)}`}</li>`)}
        ${!connected.length && html`<li>None is connected. They may come from ${origins.join(", ")}; <code>biosensor-gateway mark --web</code> shows what they need.</li>`}
        ${foreign && html`<li class="reason">Refused: a page of ${foreign}, which is not among the origins in the settings.</li>`}
      </ul>`}`;
}

export function Markers({ markers, experiments, isRecorded, isVirtual, act }) {
  const [{ note }, setNote] = useKept("note", { note: "" });
  const send = (event) => {
    event.preventDefault();
    act("POST", "/markers", { marker: "note", note, kind: "note" }).then((isDone) => isDone && setNote({ note: "" }));
  };
  const undo = (id) => act("POST", "/markers/undo", { id });
  return html`
    <section class="panel" aria-labelledby="markers">
      <h2 id="markers">Markers</h2>
      ${!isRecorded && html`<p class="small notes">This page is not recording now: a marker is in a file only if another program records it.</p>`}
      <${MarkerButtons} names=${markers.buttons} act=${act} />
      ${!isVirtual && markers.told && html`<${NameButtons} names=${markers.buttons} act=${act} />`}
      <form onSubmit=${send}>
        <label>Note, stamped when it is sent
          <input type="text" maxlength="200" size="40" required value=${note} onInput=${(event) => setNote({ note: event.target.value })} />
        </label>
        <button>Send note</button>
      </form>
      <${MarkerList} markers=${markers} undo=${undo} />
      ${experiments && html`<${Experiments} experiments=${experiments} />`}
    </section>`;
}
