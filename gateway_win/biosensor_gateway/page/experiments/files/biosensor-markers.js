// Markers of a web experiment for Biosensor Gateway, which runs on the same computer:
//
//   <script src="biosensor-markers.js"></script>
//   const markers = new BiosensorMarkers();
//   const sent = await markers.mark("stimulus on", { note: "face 3" });
//
// A classic script, because browsers load no module from a file; `import "./biosensor-markers.js"`
// does the same. docs/web-experiments.md says more. SPDX-License-Identifier: Apache-2.0
"use strict";
{
  const USUAL_PORT = 17871;
  const AT_ONCE = 20; // markers on their way
  const KEPT = 1000; // while the connection is away
  const AGAIN_MS = 1000;
  const RETRY_MS = [500, 5000];
  const REFUSED = 1008;

  // The part of a page's address after # is not sent to a server.
  const ofAddress = (name) => new URLSearchParams(location.hash.slice(1)).get(name);
  const pageTime = (at) => performance.timeOrigin + at;

  // Browsers show their time in steps, so that pages cannot use it against their user.
  function resolution() {
    let smallest = Infinity;
    for (let count = 0; count < 3; count++) {
      const before = performance.now();
      let after = before;
      while (after === before) after = performance.now();
      smallest = Math.min(smallest, after - before);
    }
    return smallest;
  }

  globalThis.BiosensorMarkers = class BiosensorMarkers {
    /** "away" until there is a connection, "ready", or "refused" for good. */
    state = "away";
    /** One sentence, unless all is well. */
    problem = "";
    #token; #address; #onstate; #socket; #setReady;
    #client = Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16)).join("-");
    #resolution = resolution();
    #waiting = new Map();
    #last = 0;
    #retryMs = RETRY_MS[0];
    #pause = 0;

    /**
     * Connects, and again whenever the connection is lost.
     * token, port: of `biosensor-gateway mark --web`; usually from the page's own address, which
     * ends in #gateway=TOKEN, and &port=PORT if that is not the usual one
     * onstate: called with (state, problem) whenever they change
     */
    constructor({ token = ofAddress("gateway") ?? "", port = ofAddress("port") ?? USUAL_PORT, onstate = () => {} } = {}) {
      this.#token = token;
      this.#address = `ws://127.0.0.1:${Number(port)}`;
      this.#onstate = onstate;
      /** Fulfilled when there is a connection and the clock has been measured. */
      this.ready = new Promise((resolve) => { this.#setReady = resolve; });
      this.#connect();
    }

    /**
     * Sends a marker. at: when it happened, as performance.now(), event.timeStamp and
     * requestAnimationFrame tell it. The promise is fulfilled with { id, lsl_time, timed_by,
     * uncertainty_s }, in seconds; it is rejected if the marker was refused.
     */
    mark(marker, { note = "", at = performance.now() } = {}) {
      const promise = new Promise((resolve, reject) => {
        if (this.state === "refused") return reject(new Error(this.problem));
        if (this.#waiting.size >= KEPT) return reject(new Error(`${KEPT} markers wait already`));
        const message = { type: "mark", ref: ++this.#last, marker, note, at: pageTime(at) };
        this.#waiting.set(message.ref, { message, resolve, reject, isSent: false });
        this.#flush();
      });
      // Whoever does not wait for it gets no error of the page: the experiment goes on.
      promise.catch((error) => console.warn(`biosensor-markers: ${marker}: ${error.message}`));
      return promise;
    }

    /** Ends the connection; what still waits is rejected. */
    close() {
      this.#end("closed by the experiment");
      this.#socket?.close();
    }

    #connect() {
      try {
        this.#socket = new WebSocket(`${this.#address}/api/v1/markers/socket`);
      } catch (error) {
        return this.#end(`this browser does not let the page connect: ${error.message}`);
      }
      const socket = this.#socket;
      socket.onopen = () => this.#say({ type: "hello", token: this.#token, client: this.#client, resolution_ms: this.#resolution });
      socket.onmessage = (event) => this.#take(JSON.parse(event.data));
      socket.onclose = (event) => this.#closed(event);
    }

    #take(message) {
      if (message.type === "ping") return this.#say({ type: "pong", n: message.n, at: pageTime(performance.now()) });
      if (message.type === "ready") {
        this.#retryMs = RETRY_MS[0];
        this.#show("ready", "");
        this.#setReady();
      }
      const waiting = this.#waiting.get(message.ref);
      if (waiting && message.again) {
        waiting.isSent = false;
        this.#pause ||= setTimeout(() => { this.#pause = 0; this.#flush(); }, AGAIN_MS);
      } else if (waiting) {
        const { type, ref, ...rest } = message;
        this.#waiting.delete(ref);
        if (type === "marked") waiting.resolve(rest); else waiting.reject(new Error(rest.problem));
      }
      this.#flush();
    }

    #flush() {
      if (this.state !== "ready" || this.#pause) return;
      const waiting = [...this.#waiting.values()];
      let free = AT_ONCE - waiting.filter((each) => each.isSent).length;
      for (const each of waiting.filter((one) => !one.isSent)) {
        if (free-- <= 0) return;
        each.isSent = true;
        this.#say(each.message);
      }
    }

    #closed(event) {
      if (this.state === "refused") return;
      if (event.code === REFUSED) return this.#end(event.reason);
      // What was on its way is sent again; the gateway knows it by its number.
      for (const each of this.#waiting.values()) each.isSent = false;
      this.#show("away", `no connection to ${this.#address}: is the page of Biosensor Gateway open there, and is ${location.origin} one of its origins?`);
      setTimeout(() => this.state === "away" && this.#connect(), this.#retryMs);
      this.#retryMs = Math.min(2 * this.#retryMs, RETRY_MS[1]);
    }

    #end(problem) {
      this.#show("refused", problem);
      for (const each of this.#waiting.values()) each.reject(new Error(problem));
      this.#waiting.clear();
    }

    #show(state, problem) {
      if (state === this.state && problem === this.problem) return;
      if (problem) console.warn(`biosensor-markers: ${problem}`);
      [this.state, this.problem] = [state, problem];
      this.#onstate(state, problem);
    }

    #say(message) {
      if (this.#socket.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
    }
  };
}
