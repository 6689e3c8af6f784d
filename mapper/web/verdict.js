// "Not enough data yet": why, what would help, and how long it is likely to take, in place of holes that nobody should rely on.

import { make, setText } from "./dom.js";

/** A time to wait, as people say it. */
export function waitText(seconds) {
  if (seconds < 90) return "about a minute";
  if (seconds < 5400) return `about ${Math.round(seconds / 60)} minutes`;
  if (seconds < 172800) return `about ${Math.round(seconds / 3600)} hours`;
  return `about ${Math.round(seconds / 86400)} days`;
}

/** A reason as a sentence of its own; nothing for none. */
export function sentence(reason) {
  return reason ? `${reason[0].toUpperCase()}${reason.slice(1)}.` : "";
}

export class Verdict {
  constructor(root) {
    this.root = root;
    this.title = make("strong", {}, "Not enough data yet");
    this.wait = make("span", { className: "verdict-wait" });
    this.reasons = make("p", { className: "verdict-reasons" });
    this.remedies = make("p", { className: "verdict-remedies" });
    root.replaceChildren(make("p", { className: "verdict-head" }, this.title, this.wait), this.reasons, this.remedies);
    this.data = null;
    this.waitS = null;
    this.standstill = null;
  }

  /** `data`: that of a map, or null where nobody knows. */
  show(data) {
    this.data = data;
    this.render();
  }

  /** How long until the data are likely to be enough [s]; null: waiting alone does not help, or nobody can tell; `standstill`: why nothing arrives, if so. */
  expect(waitS, standstill = null) {
    this.waitS = waitS;
    this.standstill = standstill;
    this.render();
  }

  render() {
    const isShort = this.data?.is_enough === false;
    this.root.hidden = !isShort;
    if (!isShort) return;
    setText(this.reasons, `Why: ${this.data.reasons.join("; ")}.`);
    setText(this.remedies, this.data.remedies.length ? `What helps: ${this.data.remedies.join("; ")}.` : "");
    setText(this.wait, this.waitS ? `Likely enough in ${waitText(this.waitS)}.` : sentence(this.standstill));
  }
}
