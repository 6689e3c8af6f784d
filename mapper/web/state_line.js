// The line of state at the top: the connection, the mission, how many biobots are there, how old the map is; and the banner of what is wrong.
// It is no live region: that the line is down or up again is said once, and what is wrong with gateways and radios is an alert, which is said.

import { say } from "./announce.js";
import { setClass, setText } from "./dom.js";
import { age, count, secondsOf } from "./format.js";
import { nameOf } from "./mission_phases.js";

// The first connection takes a moment, and so does one that is made again at once.
const GRACE_S = 2;

const element = (id) => document.getElementById(id);

export class StateLine {
  /** `onSwarm(kind)`: somebody wants to see those that are `lost`, else `unknown`, else all (""). */
  constructor({ live, onSwarm }) {
    this.live = live;
    element("swarm").addEventListener("click", () => onSwarm(this.worst));
    this.gateways = [];
    this.faults = [];
    this.map = null;
    this.phase = null;
    this.shownAt = null;
    this.wasDown = false;
    live.onState(() => this.onLine());
  }

  onLine() {
    if (!this.live.isUp) this.shownAt = new Date();
    this.showLink();
    this.showBanner();
  }

  showGateways(gateways) {
    this.gateways = gateways;
    this.showLink();
  }

  showHealth({ faults }) {
    this.faults = faults;
    this.showBanner();
  }

  showMap(status) {
    this.live.noteServerTime(status.now_wall_ns);
    this.map = status;
    this.tick();
  }

  get hasMap() {
    return this.map !== null && this.map.version !== null;
  }

  showSwarm({ online, lost, unknown }, n) {
    const chip = element("swarm");
    chip.hidden = n === 0;
    this.worst = lost ? "lost" : unknown ? "unknown" : "";
    chip.title = this.worst ? `Show those that are ${this.worst}` : "Show all";
    const parts = [`${count(online)} online`, lost ? `${count(lost)} lost` : "", unknown ? `${count(unknown)} unknown` : ""].filter(Boolean);
    setText(chip, parts.join(", "));
    setClass(chip, `chip ${lost ? "state-warn" : ""}`);
  }

  showMission({ phase }) {
    this.phase = phase;
    this.tick();
  }

  tick() {
    const chip = element("mission-chip");
    chip.hidden = this.phase === null;
    if (this.phase) {
      const word = this.phase.phase === "paused" ? "mission paused" : this.phase.phase === "done" ? "mission done" : nameOf(this.phase.phase);
      setText(chip, `${word}, ${age(this.live.serverNow() - secondsOf(this.phase.t_start_wall_ns))}`);
      setClass(chip, `chip ${this.phase.phase === "paused" ? "state-warn" : ""}`);
    }
    element("freshness").hidden = !this.hasMap;
    if (!element("freshness").hidden) {
      const { begun_wall_ns: begunNs, n_waiting: nWaiting, waiting } = this.map;
      setText(element("age"), age(this.live.serverNow() - secondsOf(begunNs)) + (nWaiting ? `, ${count(nWaiting)} to come` : ""));
      element("freshness").title = waiting ?? (nWaiting ? `${count(nWaiting)} records have come since and wait for the next map` : "of all records that have come");
    }
    this.showLink();
    this.showBanner();
  }

  showLink() {
    const alive = this.gateways.filter((gateway) => gateway.is_alive);
    const away = this.gateways.filter((gateway) => !gateway.is_alive).map((gateway) => gateway.name);
    const silent = alive.flatMap((gateway) => Object.entries(gateway.radios).filter(([, state]) => state !== "up").map(([radio, state]) => `${radio.replace(/^.*\//, "")} ${state}`));
    const [state, words] = isNobody() ? ["wait", "not signed in"]
      : !this.live.isUp ? ["bad", this.shownAt ? "mapper does not answer" : "connecting"]
      : away.length ? ["bad", `gateway ${away.join(", ")} is away`]
      : silent.length ? ["bad", silent.join(", ").replace(/^(?!radio)/, "radio ")]
      : alive.length ? ["good", `live, ${alive.length === 1 ? `gateway ${alive[0].name}` : `${alive.length} gateways`}`]
        : ["wait", "no gateway yet"];
    element("link").title = words;
    setClass(element("link"), `chip state-${!this.live.isUp && !this.shownAt ? "wait" : state}`);
    setText(element("link-text"), words);
  }

  /** What stands across the page while something is wrong; spoken once, when it begins. */
  showBanner() {
    const downS = this.live.isUp ? 0 : (performance.now() - this.live.downSince) / 1000;
    const isDown = downS > GRACE_S;
    const old = this.shownAt ? `What you see is from ${this.shownAt.toLocaleTimeString()}` : "There is nothing to show yet";
    const words = isDown && isNobody() ? `Nobody is signed in. ${old}.`
      : isDown ? `No answer from the mapper for ${age(downS)}. ${old}; it may have changed since. Trying again.`
      : this.live.isUp && this.faults.length ? `The mapper says: ${this.faults.join(" · ")}` : "";
    element("banner").hidden = words === "";
    setText(element("banner"), words);
    document.body.classList.toggle("is-old", isDown);
    if (isDown !== this.wasDown && !isNobody()) say(isDown ? "The mapper does not answer; what is shown may be old." : "The mapper answers again.", { isUrgent: isDown });
    this.wasDown = isDown;
  }
}

/** Nobody is signed in, and nobody may look. */
function isNobody() {
  return document.body.dataset.role === "nobody";
}
