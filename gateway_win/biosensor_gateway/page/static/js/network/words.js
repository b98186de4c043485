// Puts what was seen of the network into words. Each state has a sign of its own.

const STATES = {
  streaming: ["●", "good", "streaming"],
  waiting: ["●", "good", "there"],
  opening: ["◌", "warn", "opening"],
  reading: ["◌", "warn", "reading its description"],
  listed: ["○", "", "there, not received"],
  silent: ["▲", "bad", "silent"],
  gone: ["■", "bad", "gone"],
};

export function span(seconds) {
  if (seconds < 60) return `${Math.floor(seconds)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min`;
  return `${Math.floor(seconds / 3600)} h`;
}

export function seenOf(each) {
  const [sign, tone, word] = STATES[each.seen] ?? ["?", "bad", each.seen];
  if (each.replay && each.seen === "streaming") return { sign: "↻", tone: "replayed", word: "replay, not a person" };
  if (each.seen === "silent") return { sign, tone, word: `silent for ${span(each.silent_s)}` };
  if (each.seen === "gone") return { sign, tone, word: `gone for ${span(each.silent_s)}` };
  if (each.seen === "streaming" && each.worn === false) return { sign: "◐", tone: "warn", word: "not worn" };
  return { sign, tone, word };
}

// The agent counts what is lost; for other programs the stamps show about how much is missing.
export function lostOf(each) {
  if (each.lost === null) return "–";
  return each.is_lost_estimated ? `about ${each.lost}` : `${each.lost}`;
}

export function trafficOf(stream) {
  const bytes = stream.bytes_per_s;
  return bytes >= 1e6 ? `${(bytes / 1e6).toFixed(1)} MB/s` : `${Math.ceil(bytes / 1e3)} kB/s`;
}
