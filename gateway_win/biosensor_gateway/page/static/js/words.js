// Puts states and figures into words. Each state has a sign of its own: colour alone says nothing.

const STATES = {
  streaming: ["●", "good", "streaming"],
  "not worn": ["◐", "warn", "not worn"],
  searching: ["◌", "warn", "looking for it"],
  connecting: ["◌", "warn", "connecting"],
  "no data": ["▲", "bad", "no data yet"],
  refused: ["▲", "bad", "will try again"],
  paused: ["❚❚", "warn", "paused: nothing is sent"],
  stopped: ["■", "bad", "stopped"],
};

export function stateOf(device) {
  const [sign, tone, word] = STATES[device.state] ?? ["?", "bad", device.state];
  return { sign, tone, word };
}

export function personOf(device) {
  return [device.participant, device.label].filter(Boolean).join(" · ");
}

export function figure(value, unit) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  const digits = size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  return `${value.toFixed(digits)}${unit && unit !== "none" ? ` ${unit}` : ""}`;
}

export function rateOf(stream) {
  if (!stream.nominal_hz) return "when it changes";
  const measured = stream.rate_hz === null ? "–" : stream.rate_hz.toFixed(1);
  return `${measured} of ${Number(stream.nominal_hz.toFixed(1))} Hz`;
}

export function ageOf(stream) {
  if (stream.age_s === null) return "nothing yet";
  if (stream.age_s < 60) return `${stream.age_s.toFixed(1)} s`;
  return `${Math.floor(stream.age_s / 60)} min`;
}

export function valueOf(stream) {
  if (!stream.channels.length || !stream.is_fresh || !stream.values.length) return "–";
  return figure(stream.values[0], stream.units[0]);
}
