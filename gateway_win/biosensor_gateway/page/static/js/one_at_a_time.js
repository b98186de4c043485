// Keeps a button off while its own request is under way.

import { useState } from "../vendor/preact-htm.js";

// What the server told may be older than its answer, and a click on a button that is off is lost.
export function useOneAtATime(act) {
  const [isUnderWay, setUnderWay] = useState(false);
  const once = async (...request) => {
    setUnderWay(true);
    const isDone = await act(...request);
    setUnderWay(false);
    return isDone;
  };
  return [isUnderWay, once];
}
