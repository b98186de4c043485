// A small trace, as it stands on cards.

import { html, useEffect, useRef } from "../vendor/preact-htm.js";
import { drawSpark } from "./draw.js";

export function Spark({ live, stream, marks = [] }) {
  const canvas = useRef();
  useEffect(() => {
    const draw = () => canvas.current && drawSpark(canvas.current, live, stream, marks);
    live.onPicture.add(draw);
    return () => live.onPicture.delete(draw);
  }, [live, stream]);
  return html`<canvas ref=${canvas} aria-hidden="true"></canvas>`;
}
