// What came of something, for some seconds; never where a person is about to press.

import { html, useLayoutEffect, useRef, useState } from "../vendor/preact-htm.js";
import { worded } from "./words.js";

const EDGES = ["bottom", "top"];
const AGAIN_ON = ["scroll", "resize"];

function covers(place) {
  const own = place.getBoundingClientRect();
  return [...document.querySelectorAll("[data-clear]")].some((each) => {
    const other = each.getBoundingClientRect();
    return other.width > 0 && own.left < other.right && other.left < own.right && own.top < other.bottom && other.top < own.bottom;
  });
}

export function Toast({ told, onClose }) {
  const place = useRef();
  const [edge, setEdge] = useState(EDGES[0]);
  useLayoutEffect(() => {
    const settle = () => {
      for (const each of EDGES) {
        place.current.dataset.edge = each;
        if (!covers(place.current)) return setEdge(each);
      }
      return setEdge(EDGES[0]);
    };
    settle();
    for (const each of AGAIN_ON) addEventListener(each, settle);
    return () => { for (const each of AGAIN_ON) removeEventListener(each, settle); };
  }, [told]);
  return html`<p class="toast" ref=${place} data-edge=${edge}>${worded(told.text)} ${told.isProblem && html`<button onClick=${onClose}>Close</button>`}</p>`;
}
