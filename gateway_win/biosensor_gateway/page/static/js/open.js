// Which device is open, so that the browser's Back closes its details and does not leave the page.

import { useEffect, useState } from "../vendor/preact-htm.js";

export function useOpen() {
  const [open, setOpen] = useState(history.state?.open ?? null);
  useEffect(() => {
    const move = ({ state }) => setOpen(state?.open ?? null);
    addEventListener("popstate", move);
    return () => removeEventListener("popstate", move);
  }, []);
  const show = (name) => {
    if (name === null && history.state?.open) return history.back();
    if (name !== null) history.pushState({ open: name }, "");
    return setOpen(name);
  };
  return [open, show];
}
