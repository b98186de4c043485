// Draws traces: small ones on a canvas of their own, large ones with axes by uPlot.

import uPlot from "../vendor/uPlot.js";

// Devices send lumps of up to some seconds: at the right edge, so much may still be to come.
const LUMP_S = 3;

// Asking for one makes the browser work out the styles of the page; a trace is drawn 20 times a second.
const DARK = matchMedia("(prefers-color-scheme: dark)");
const colours = new Map();
DARK.addEventListener("change", () => colours.clear());

function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colours.get(name);
}

// How many pixels may be without a sample before that is a gap.
function patience(stream, binS) {
  return stream.nominal_hz ? Math.max(2, Math.ceil(3 / stream.nominal_hz / binS)) : Infinity;
}

function range(trace, channel) {
  let low = Infinity;
  let high = -Infinity;
  for (let i = 0; i < trace.numbers.length; i++) {
    if (trace.low[i][channel] < low) low = trace.low[i][channel];
    if (trace.high[i][channel] > high) high = trace.high[i][channel];
  }
  if (!(high >= low)) return null;
  return high > low ? [low, high] : [low - 1, high + 1];
}

// A sign at the upper edge for each sample of a stream that marks this one, filled or not.
function drawMarks(pen, live, marks, place, scale) {
  for (const mark of marks) {
    const trace = live.traces.get(mark.source_id);
    pen.fillStyle = pen.strokeStyle = colour("--text");
    pen.lineWidth = scale;
    trace?.numbers.forEach((number, i) => {
      const { x, top } = place(number);
      if (x === null) return;
      pen.beginPath();
      pen.moveTo(x - 3.5 * scale, top);
      pen.lineTo(x + 3.5 * scale, top);
      pen.lineTo(x, top + 6 * scale);
      pen.closePath();
      if (mark.isFilled(trace.high[i])) pen.fill();
      pen.stroke();
    });
  }
}

export function drawSpark(canvas, live, stream, marks) {
  const scale = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * scale);
  const height = Math.round(canvas.clientHeight * scale);
  if (!width || !height) return;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, width, height);
  const trace = live.traces.get(stream.source_id);
  const span = trace && range(trace, 0);
  if (!span) return;
  const pixels = live.view.window_s / live.binS;
  const begin = live.now / live.binS - pixels;
  const x = (number) => ((number - begin) / pixels) * width;
  const y = (value) => height - 2 - ((value - span[0]) / (span[1] - span[0])) * (height - 4);
  const limit = patience(stream, live.binS);
  pen.fillStyle = colour("--gap");
  pen.strokeStyle = colour("--trace");
  pen.lineWidth = scale;
  pen.beginPath();
  let last = null;
  trace.numbers.forEach((number, i) => {
    const isGap = last !== null && number - last > limit;
    if (isGap) pen.fillRect(x(last), 0, x(number) - x(last), height);
    if (last === null || isGap) pen.moveTo(x(number), y(trace.low[i][0]));
    else pen.lineTo(x(number), y(trace.low[i][0]));
    pen.lineTo(x(number), y(trace.high[i][0]));
    last = number;
  });
  pen.stroke();
  const newest = live.now / live.binS;
  if (stream.nominal_hz && last !== null && newest - last > Math.max(limit, LUMP_S / live.binS)) {
    pen.fillRect(x(last), 0, width - x(last), height);
  }
  drawMarks(pen, live, marks, (number) => ({ x: x(number), top: scale }), scale);
}

// Smallest and largest value of each pixel as one line up and down; null where there is a gap.
function series(live, stream, trace) {
  const times = [];
  const channels = stream.channels.map(() => []);
  const limit = patience(stream, live.binS);
  const put = (time, rows) => {
    times.push(time);
    channels.forEach((values, c) => values.push(rows === null ? null : rows[c]));
  };
  trace.numbers.forEach((number, i) => {
    const time = number * live.binS - live.now;
    if (i && number - trace.numbers[i - 1] > limit) put(time, null);
    put(time, trace.low[i]);
    put(time, trace.high[i]);
  });
  return [times, ...channels];
}

// A colour and a dash for each channel, so that colour alone tells nothing.
const LINES = ["--trace", "--warn", "--good", "--bad", "--soft"];
const DASHES = [[], [6, 3], [2, 2], [9, 3, 2, 3], [1, 4]];

export function lineOf(channel) {
  return { colour: `var(${LINES[channel % LINES.length]})`, dash: DASHES[channel % DASHES.length].join(" ") };
}

export class Plot {
  constructor(element, live, stream) {
    this.live = live;
    this.stream = stream;
    this.marks = [];
    // Functions: the screen may turn dark while the plot is there.
    const thin = { stroke: () => colour("--line"), width: 1 };
    const axis = { stroke: () => colour("--soft"), grid: thin, ticks: thin };
    this.element = element;
    this.plot = new uPlot(
      {
        width: element.clientWidth,
        height: 150,
        cursor: { show: false },
        legend: { show: false },
        scales: { x: { time: false, range: () => [-live.view.window_s, 0] } },
        hooks: { draw: [(plot) => this.drawMarks(plot)] },
        axes: [
          { ...axis, values: (_, ticks) => ticks.map((tick) => `${tick} s`) },
          { ...axis, size: 64 },
        ],
        series: [
          {},
          ...stream.channels.map((label, c) => ({
            label,
            stroke: () => colour(LINES[c % LINES.length]),
            dash: DASHES[c % DASHES.length],
            width: 1,
            points: { show: !stream.nominal_hz },
            spanGaps: false,
          })),
        ],
      },
      [[], ...stream.channels.map(() => [])],
      element,
    );
    // Also of one without samples, which is never drawn: else the page stays as wide as it was.
    this.sizes = new ResizeObserver(() => this.fit());
    this.sizes.observe(element);
    // One without samples is drawn at no other time.
    this.repaint = () => this.plot.redraw();
    DARK.addEventListener("change", this.repaint);
  }

  fit() {
    const width = this.element.clientWidth;
    if (width && width !== this.plot.width) this.plot.setSize({ width, height: 150 });
  }

  drawMarks(plot) {
    const { ctx, bbox } = plot;
    const place = (number) => {
      const x = plot.valToPos(number * this.live.binS - this.live.now, "x", true);
      return { x: x < bbox.left ? null : x, top: bbox.top };
    };
    drawMarks(ctx, this.live, this.marks, place, window.devicePixelRatio || 1);
  }

  draw(marks) {
    this.marks = marks;
    const trace = this.live.traces.get(this.stream.source_id);
    if (!trace || trace.channels !== this.stream.channels.length) return;
    this.plot.setData(series(this.live, this.stream, trace));
  }

  end() {
    this.sizes.disconnect();
    DARK.removeEventListener("change", this.repaint);
    this.plot.destroy();
  }
}
