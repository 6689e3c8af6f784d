// Maps of the past: slide, step or play through them, and come back to the live one. Beside it stands what has changed since.

import { make, setText } from "./dom.js";
import { age, clock } from "./format.js";

const PLAY_MS = 900;

export class TimeSlider {
  /** `onPick(version | null)`: null is the live map; must return a promise that is done when the map is shown. */
  constructor(root, { live, onPick }) {
    Object.assign(this, { live, onPick });
    this.maps = [];
    this.version = null;
    this.timer = null;
    this.back = this.button("step-back", "❮", "The map before", () => this.step(-1));
    this.play = this.button("play", "▶", "Play", () => (this.timer === null ? this.start() : this.stop()));
    this.on = this.button("step-on", "❯", "The next map", () => this.step(1));
    this.range = make("input", { id: "time", type: "range", min: "0", max: "0", value: "0", step: "1", "aria-label": "Time of the map" });
    this.range.addEventListener("input", () => {
      // Read first: whatever is rendered meanwhile puts the slider back to the map that is still shown.
      const { version } = this.maps[Number(this.range.value)];
      this.stop();
      this.pick(version);
    });
    this.goLive = make("button", { id: "go-live", type: "button", className: "go-live", "aria-pressed": "true", onclick: () => this.returnToLive() }, "Live");
    this.when = make("p", { id: "time-text", className: "time-text", role: "status" });
    root.replaceChildren(make("div", { className: "time-row", role: "group", "aria-label": "Maps of the past" }, this.back, this.play, this.on, this.range, this.goLive), this.when);
    root.addEventListener("keydown", (event) => {
      if (event.key === "Escape" && this.version !== null) this.returnToLive();
    });
    this.root = root;
    root.hidden = true;
    setInterval(() => this.render(), 1000);
  }

  button(id, text, label, click) {
    return make("button", { id, type: "button", "aria-label": label, title: label, onclick: click }, text);
  }

  /** All that are kept, the oldest first: [{version, wall_ns, ...}]. */
  show(maps) {
    this.maps = maps;
    this.root.hidden = maps.length < 2;
    this.range.max = String(Math.max(0, maps.length - 1));
    this.render();
  }

  /** What has changed between the map that is shown and the live one, in words. */
  tellChange(text) {
    this.change = text;
    this.render();
  }

  place() {
    if (this.version === null) return this.maps.length - 1;
    const at = this.maps.findIndex((map) => map.version >= this.version);
    return at < 0 ? this.maps.length - 1 : at;
  }

  step(by) {
    this.stop();
    const at = this.place() + by;
    if (at < 0 || at >= this.maps.length) return;
    this.pick(this.maps[at].version);
  }

  start() {
    if (this.place() >= this.maps.length - 1) this.pick(this.maps[0].version);
    const go = async () => {
      const at = this.place() + 1;
      if (at >= this.maps.length) return this.returnToLive();
      await this.pick(this.maps[at].version);
      if (this.timer !== null) this.timer = setTimeout(go, PLAY_MS);
    };
    this.timer = setTimeout(go, PLAY_MS);
    this.render();
  }

  stop() {
    clearTimeout(this.timer);
    this.timer = null;
    this.render();
  }

  returnToLive() {
    this.stop();
    return this.pick(null);
  }

  pick(version) {
    this.version = version;
    this.change = null;
    this.render();
    return this.onPick(version);
  }

  render() {
    if (this.root.hidden) return;
    const at = this.place(), map = this.maps[at];
    if (Number(this.range.value) !== at) this.range.value = String(at);
    const isLive = this.version === null;
    const text = isLive ? `Live: the newest map. Slide back to see earlier ones, from ${clock(this.maps[0].wall_ns / 1e9)} on` : `${clock(map.wall_ns / 1e9)}, ${age(this.live.serverNow() - map.wall_ns / 1e9)} ago`;
    setText(this.when, this.change ? `${text}. Since then: ${this.change}.` : text);
    // What has changed may be long, and is scrolled then: by keys, too.
    this.when.tabIndex = isLive ? -1 : 0;
    this.range.setAttribute("aria-valuetext", text);
    this.goLive.setAttribute("aria-pressed", String(isLive));
    this.root.classList.toggle("past", !isLive);
    this.play.textContent = this.timer === null ? "▶" : "❚❚";
    this.play.setAttribute("aria-label", this.timer === null ? "Play" : "Pause");
    this.back.disabled = at <= 0;
    this.on.disabled = isLive;
  }
}
