// What changed is asked for again, and only that: follows the event stream, and comes back when the line was down.

import { EventParser } from "./event_parser.js";
import { readTexts } from "./net.js";

const MIN_PERIOD_MS = 400;
// The mapper says something every 15 s, so that a line that is dead can be told from one where nothing happens.
const SILENCE_MS = 40_000;
const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5000;

export class Live {
  constructor() {
    this.versions = {};
    this.followers = [];
    this.listeners = [];
    this.isUp = false;
    this.downSince = performance.now();
    this.clockOffsetS = 0;
    this.line = null;
    this.wake = () => {};
  }

  /** Run `task()` now, and again after each change of a topic, after each reconnection, and after whoever looks has changed. */
  follow(topics, task) {
    const run = paced(task);
    this.followers.push({ topics, run });
    if (this.isUp) run();
  }

  /** Call `listener()` whenever the line has come up or gone down. */
  onState(listener) {
    this.listeners.push(listener);
  }

  /** Seconds since 1970 by the mapper's clock, as far as it is known. */
  serverNow() {
    return Date.now() / 1000 + this.clockOffsetS;
  }

  /** Learn the mapper's clock from an answer that tells it [ns]. */
  noteServerTime(wallNs) {
    this.clockOffsetS = wallNs / 1e9 - Date.now() / 1000;
  }

  /** Begin anew at once: somebody else looks, or somebody wants to know. */
  restart() {
    this.wake();
    this.line?.abort();
  }

  /** Follow the stream for ever. */
  async run() {
    let waitMs = FIRST_WAIT_MS;
    for (;;) {
      const begun = performance.now();
      const problem = await this.listen().catch((error) => error);
      this.setUp(false);
      waitMs = performance.now() - begun > LONGEST_WAIT_MS ? FIRST_WAIT_MS : Math.min(waitMs * 2, LONGEST_WAIT_MS);
      // Without a token that counts there is nothing to try again; signing in begins anew.
      const pause = problem?.status === 401 ? 1e9 : this.isRestarting() ? 0 : waitMs;
      await new Promise((resolve) => {
        const timer = setTimeout(resolve, pause);
        this.wake = () => {
          clearTimeout(timer);
          resolve();
        };
      });
    }
  }

  isRestarting() {
    return this.line.signal.aborted && this.line.signal.reason !== "silence";
  }

  async listen() {
    const line = new AbortController();
    this.line = line;
    let timer = null;
    const heard = () => {
      clearTimeout(timer);
      timer = setTimeout(() => line.abort("silence"), SILENCE_MS);
    };
    const parser = new EventParser({ onEvent: ({ type, data }) => type === "change" && this.take(JSON.parse(data)) });
    heard();
    try {
      for await (const text of readTexts("/api/v1/events", line.signal)) {
        heard();
        parser.feed(text);
      }
    } finally {
      clearTimeout(timer);
    }
    return null;
  }

  take(versions) {
    const isNew = !this.isUp;
    const before = this.versions;
    this.versions = versions;
    this.setUp(true);
    for (const { topics, run } of this.followers) {
      if (isNew || topics.some((topic) => versions[topic] !== before[topic])) run();
    }
  }

  setUp(isUp) {
    if (this.isUp === isUp) return;
    this.isUp = isUp;
    this.downSince = isUp ? null : performance.now();
    this.listeners.forEach((listener) => listener());
  }
}

/** Run a task soon, once for many calls, and never twice at a time; again after a while where it failed. */
export function paced(task) {
  let isWanted = false, isRunning = false, nFailures = 0;
  const run = async () => {
    isRunning = true;
    while (isWanted) {
      isWanted = false;
      try {
        await task();
        nFailures = 0;
      } catch (problem) {
        if (problem.status === undefined) console.error(problem);
        // Whoever lacks a token or a role gets no other answer by asking again.
        if (![401, 403].includes(problem.status)) setTimeout(start, Math.min(2000 * 2 ** nFailures++, 30_000));
      }
      await new Promise((resolve) => setTimeout(resolve, MIN_PERIOD_MS));
    }
    isRunning = false;
  };
  const start = () => {
    isWanted = true;
    if (!isRunning) run();
  };
  return start;
}
