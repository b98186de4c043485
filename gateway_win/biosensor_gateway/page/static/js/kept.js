// Keeps what a person has typed while its panel is away, and when the page is loaded again.

import { useState } from "../vendor/preact-htm.js";

export function useKept(name, usual) {
  const [value, setValue] = useState(() => ({ ...usual, ...JSON.parse(sessionStorage.getItem(name)) }));
  // A change is of the newest value: an effect of before must not undo what was typed since.
  const change = (part) => setValue((now) => {
    const next = { ...now, ...part };
    sessionStorage.setItem(name, JSON.stringify(next));
    return next;
  });
  return [value, change];
}
