// Keeps what a person has typed while its panel is away, and when the page is loaded again.

import { useState } from "../vendor/preact-htm.js";

export function useKept(name, usual) {
  const [value, setValue] = useState(() => JSON.parse(sessionStorage.getItem(name)) ?? usual);
  const keep = (next) => {
    sessionStorage.setItem(name, JSON.stringify(next));
    setValue(next);
  };
  return [value, keep];
}
