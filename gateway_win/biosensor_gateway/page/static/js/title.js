// The window's title and icon tell of a recording, so that red is seen in a window in the background;
// for who looks elsewhere, a sound and a notice of the system.

import { html, useEffect, useRef, useState } from "../vendor/preact-htm.js";

const OWN = document.title;
const TOLD = {
  green: ["● recording", "icon-green.svg"],
  amber: ["◐ recording, look at it", "icon-amber.svg"],
  red: ["▲ recording: something is wrong", "icon-red.svg"],
  ended: ["▲ the recording has ended", "icon-red.svg"],
  away: ["▲ no answer", "icon-red.svg"],
};

function colourOf(status) {
  if (status === undefined || status?.ended) return "";
  if (status === null) return "away";
  const { recording } = status;
  if (recording.is_running) return recording.colour;
  return recording.file && !recording.verdict ? "ended" : "";
}

const ALARMING = new Set(["red", "ended", "away"]);
const KEPT = "alarm";
const BEEPS_S = [0, 0.4, 0.8];
let audio = null;

function beep() {
  audio ??= new AudioContext();
  audio.resume();
  for (const after of BEEPS_S) {
    const tone = new OscillatorNode(audio, { frequency: 880 });
    const loud = new GainNode(audio, { gain: 0.2 });
    tone.connect(loud).connect(audio.destination);
    tone.start(audio.currentTime + after);
    tone.stop(audio.currentTime + after + 0.2);
  }
}

function alarm(words, problem) {
  beep();
  if (globalThis.Notification?.permission === "granted") new Notification(words, { body: problem, tag: KEPT });
}

// Off until somebody wants it, for a participant hears it, too. Kept for all windows until the page's
// program ends: at its next start the browser takes it for another site.
export function Alarm() {
  const [isOn, setOn] = useState(localStorage.getItem(KEPT) === "on");
  const change = async (event) => {
    const wanted = event.target.checked;
    setOn(wanted);
    localStorage.setItem(KEPT, wanted ? "on" : "off");
    // Browsers allow both only where somebody has clicked.
    if (wanted) beep();
    if (wanted && globalThis.Notification?.permission === "default") await Notification.requestPermission();
  };
  return html`<label class="check small"><input type="checkbox" checked=${isOn} onChange=${change} /> sound and notification when something is wrong</label>`;
}

export function useTitle(status) {
  const colour = colourOf(status);
  const before = useRef("");
  useEffect(() => {
    const [words, icon] = TOLD[colour] ?? ["", "icon.svg"];
    document.title = words ? `${words} – ${OWN}` : OWN;
    document.querySelector("link[rel=icon]").href = icon;
    const wasWell = before.current === "green" || before.current === "amber";
    if (wasWell && ALARMING.has(colour) && localStorage.getItem(KEPT) === "on") alarm(words, status?.recording.problems[0] ?? "");
    before.current = colour;
  }, [colour]);
}
