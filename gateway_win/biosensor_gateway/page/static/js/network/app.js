// The page of the network: every LSL stream that this computer sees. It steers nothing.

import { html, render, useEffect, useRef, useState } from "../../vendor/preact-htm.js";
import { Live } from "../live.js";
import { useOpen } from "../open.js";
import { SeenCards, cardStreams } from "./cards.js";
import { SeenDetail, detailStreams } from "./detail.js";

const WINDOW_S = 10;
const SPARK_PIXELS = 300;
const PLOT_PIXELS = 900;
const PATIENCE_S = 5;
const MOST_ASKED = 200;

function Head({ status }) {
  const devices = status?.devices ?? [];
  const streams = devices.reduce((sum, each) => sum + each.streams.length, 0);
  const hosts = new Set(devices.map((each) => each.host)).size;
  const many = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;
  return html`
    <header>
      <h1>Streams on this network</h1>
      ${status && html`<span class="small" role="status">${many(streams, "stream")} of ${many(hosts, "computer")}</span>`}
    </header>`;
}

function Nothing({ status }) {
  if (status.searched_s < PATIENCE_S) return html`<p class="wait">Looking for streams …</p>`;
  return html`
    <section class="panel notice">
      <h2>No LSL stream is seen here yet</h2>
      <ul class="checks">${status.search.map((each) => html`<li>${each}</li>`)}</ul>
      <p class="small soft">This page keeps looking.</p>
    </section>`;
}

function Notices({ status }) {
  return html`
    ${status.not_received > 0 && html`<p class="panel notice">${status.not_received} of the streams in view are not received: at most ${status.most_inlets} are received at a time, so that this page does not multiply the traffic. Show fewer by their names, or close other windows of this page.</p>`}
    ${status.problems.length > 0 && html`<section class="panel problem"><h2>Not all streams can be shown</h2><ul class="checks small">${status.problems.map((each) => html`<li>${each}</li>`)}</ul></section>`}`;
}

function Filter({ text, onText }) {
  return html`
    <form onSubmit=${(event) => event.preventDefault()}>
      <label>Only names with
        <input type="text" maxlength="60" value=${text} onInput=${(event) => onText(event.target.value)} />
      </label>
    </form>`;
}

function matches(device, text) {
  const names = [device.title, device.unit, device.host, device.participant, device.label, ...device.streams.map((each) => each.lsl_name)];
  return names.some((name) => name.toLowerCase().includes(text.toLowerCase()));
}

function App() {
  const [status, setStatus] = useState(undefined);
  const [open, setOpen] = useOpen();
  const [text, setText] = useState("");
  const [firsts, setFirsts] = useState({});
  const live = useRef(null);
  const visible = useRef(new Set());
  useEffect(() => {
    live.current = new Live(setStatus);
    window.biosensorLive = live.current;
  }, []);

  const all = status?.devices ?? [];
  const devices = text ? all.filter((each) => matches(each, text)) : all;
  const device = all.find((each) => each.name === open);
  useEffect(() => {
    if (!live.current || !status) return;
    const inView = devices.filter((each) => visible.current.has(each.name));
    const shown = device ? detailStreams(device, firsts) : inView.flatMap(cardStreams);
    const keys = shown.map((each) => each.source_id).slice(0, MOST_ASKED);
    live.current.show(keys, WINDOW_S, device ? PLOT_PIXELS : SPARK_PIXELS);
  }, [status, firsts]);

  if (status === undefined) return html`<p class="wait">Opening …</p>`;
  return html`
    <${Head} status=${status} />
    <main>
      ${!status && html`<p class="panel problem" role="alert">The page's program does not answer. Nothing shown here is current. If it was ended, start it again: biosensor-gateway page --lsl.</p>`}
      ${status && html`<${Notices} status=${status} />`}
      ${status && !all.length && !status.problems.length && html`<${Nothing} status=${status} />`}
      ${device
        ? html`<${SeenDetail} live=${live.current} device=${device} firsts=${firsts} onChoose=${(key, first) => setFirsts({ ...firsts, [key]: first })} onClose=${() => setOpen(null)} />`
        : html`
          ${all.length > 1 && html`<${Filter} text=${text} onText=${setText} />`}
          <${SeenCards} live=${live.current} devices=${devices} visible=${visible.current} onOpen=${setOpen} />`}
    </main>
    <footer class="small">Streams are received only while they are in view. Nothing on this page changes or stops a stream.</footer>`;
}

render(html`<${App} />`, document.getElementById("page"));
