// The window's title and icon tell of a recording, so that red is seen in a window in the background.

import { useEffect } from "../vendor/preact-htm.js";

const OWN = document.title;
const TOLD = {
  green: ["● recording", "icon-green.svg"],
  amber: ["◐ recording, look at it", "icon-amber.svg"],
  red: ["▲ recording: not all is well", "icon-red.svg"],
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

export function useTitle(status) {
  const colour = colourOf(status);
  useEffect(() => {
    const [words, icon] = TOLD[colour] ?? ["", "icon.svg"];
    document.title = words ? `${words} – ${OWN}` : OWN;
    document.querySelector("link[rel=icon]").href = icon;
  }, [colour]);
}
