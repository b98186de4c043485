// Keeps the WebSocket to the server, and the bins of all traces that are on the screen.

const HEAD_BYTES = 20;
const BLOCK_BYTES = 12;
const RETRY_MS = 500;
// The server says by it that somebody has ended the page.
const ENDED = 4000;

// The bins of one stream: smallest and largest value of each pixel, by the pixel's number.
export class Trace {
  constructor() {
    this.channels = 0;
    this.numbers = [];
    this.low = [];
    this.high = [];
  }

  add(numbers, low, high, channels) {
    this.channels = channels;
    for (let i = 0; i < numbers.length; i++) {
      const lows = low.subarray(i * channels, (i + 1) * channels);
      const highs = high.subarray(i * channels, (i + 1) * channels);
      if (this.numbers.at(-1) === numbers[i]) this.merge(lows, highs);
      else {
        this.numbers.push(numbers[i]);
        this.low.push(Float32Array.from(lows));
        this.high.push(Float32Array.from(highs));
      }
    }
  }

  // A pixel that comes again has what was measured in it since.
  merge(lows, highs) {
    const low = this.low.at(-1);
    const high = this.high.at(-1);
    for (let c = 0; c < low.length; c++) {
      if (!(low[c] <= lows[c])) low[c] = lows[c];
      if (!(high[c] >= highs[c])) high[c] = highs[c];
    }
  }

  forget(before) {
    let count = 0;
    while (count < this.numbers.length && this.numbers[count] < before) count++;
    if (count) for (const list of [this.numbers, this.low, this.high]) list.splice(0, count);
  }
}

export class Live {
  constructor(onState) {
    this.onState = onState;
    this.onPicture = new Set();
    this.pictures = 0;
    this.generation = 0;
    this.view = { streams: [], window_s: 10, pixels: 600 };
    this.traces = new Map();
    this.now = 0;
    this.binS = 0;
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/live`);
    this.socket.binaryType = "arraybuffer";
    // Without a stream there is nothing to ask for, and the server has other things to load first.
    this.socket.onopen = () => this.view.streams.length && this.ask();
    this.socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.onState(JSON.parse(data));
      else this.read(data);
    };
    this.socket.onclose = ({ code }) => {
      if (code === ENDED) return this.onState({ ended: true });
      this.onState(null);
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  show(streams, windowS, pixels) {
    const view = { streams: [...new Set(streams)], window_s: windowS, pixels };
    if (JSON.stringify(view) === JSON.stringify(this.view)) return;
    this.view = view;
    this.ask();
  }

  ask() {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.generation += 1;
    this.traces = new Map(this.view.streams.map((name) => [name, new Trace()]));
    this.socket.send(JSON.stringify({ generation: this.generation, ...this.view }));
  }

  read(buffer) {
    const head = new DataView(buffer);
    if (head.getUint32(0, true) !== this.generation) return;
    this.now = head.getFloat64(4, true);
    this.binS = head.getFloat64(12, true);
    let at = HEAD_BYTES;
    while (at < buffer.byteLength) at = this.readBlock(buffer, head, at);
    const oldest = (this.now - this.view.window_s) / this.binS - 1;
    for (const trace of this.traces.values()) trace.forget(oldest);
    this.pictures += 1;
    for (const draw of this.onPicture) draw();
  }

  readBlock(buffer, head, at) {
    const n = head.getUint32(at, true);
    const index = head.getUint16(at + 4, true);
    const channels = head.getUint16(at + 6, true);
    const first = head.getUint32(at + 8, true);
    at += BLOCK_BYTES;
    const part = (Kind, count) => {
      const values = new Kind(buffer.slice(at, at + 4 * count));
      at += 4 * count;
      return values;
    };
    const numbers = part(Uint32Array, n).map((each) => each + first);
    const low = part(Float32Array, n * channels);
    const high = part(Float32Array, n * channels);
    this.traces.get(this.view.streams[index])?.add(numbers, low, high, channels);
    return at;
  }
}
