// One biobot in the table: what is said of it, its commands, and how far the last one has come.

import { linkOf, modeOf, silenceOf } from "./biobot_state.js";
import { make, makeButton, setClass, setHidden, setText, setTitle } from "./dom.js";
import { age, count } from "./format.js";

export const COLUMNS = [
  { name: "id", label: "id" },
  { name: "state", label: "state" },
  { name: "mode", label: "mode" },
  { name: "battery", label: "battery", isNumber: true },
  { name: "heard", label: "heard", isNumber: true },
  { name: "rate", label: "met/min", isNumber: true, more: "encounters per minute" },
  { name: "link", label: "link", isNumber: true },
];
// What is not a stop is not given twice while it is under way: a second one would be a second stimulus.
const ACTIONS = [
  { action: "stop", label: "Stop", name: (key) => `Stop biobot ${key}` },
  { action: "start", label: "Start", name: (key) => `Start biobot ${key}` },
  { action: "turn_left", label: "↰", name: (key) => `Turn biobot ${key} left` },
  { action: "turn_right", label: "↱", name: (key) => `Turn biobot ${key} right` },
];
const STEPS = ["sent", "accepted by the gateway", "sent by the radio", "confirmed by the biobot"];
const LAST_STEP = 3;

export class RosterRow {
  constructor({ biobot, onCommand, onMore, onPlace, account }) {
    const { key } = biobot;
    this.key = key;
    this.account = account;
    this.biobot = biobot;
    this.isUnderWay = false;
    this.cells = Object.fromEntries(COLUMNS.slice(1).map(({ name, isNumber }) => [name, make("td", { role: "cell", className: `c-${name}${isNumber ? " number" : ""}` })]));
    [this.state, this.mode, this.link] = ["state", "mode", "link"].map((name) => {
      const span = make("span");
      this.cells[name].append(span);
      return span;
    });
    this.place = makeButton("landmark", () => onPlace(`landmark:${key}`), { className: "mode landmark", tabIndex: -1, hidden: true, "aria-label": `landmark: show ${key} on the map` });
    this.cells.mode.append(this.place);
    this.dbm = make("span", { className: "dbm" });
    this.link.append(this.dbm);
    this.buttons = ACTIONS.map(({ action, label, name }) => {
      const button = makeButton(label, () => onCommand(this, action, name(key)), { className: action, tabIndex: -1, "aria-label": name(key) });
      account.guard(button, "operator", () => this.refusalOf(action));
      return button;
    });
    this.guarded = [...this.buttons];
    const more = makeButton("⋯", () => onMore(this, more), { className: "more", tabIndex: -1, "aria-label": `More of biobot ${key}`, "aria-haspopup": "dialog" });
    this.buttons.push(more);
    this.steps = make("span", { className: "steps", role: "img", hidden: true }, ...Array.from({ length: LAST_STEP }, () => make("i")));
    const commands = make("td", { role: "cell", className: "c-commands" }, make("div", { className: "actions" }, ...this.buttons, this.steps));
    // Said outright: where rows are no table rows to look at, on a phone, they still are to a screen reader.
    this.element = make("tr", { role: "row", "data-key": key }, make("th", { scope: "row", role: "rowheader" }, key), ...Object.values(this.cells), commands);
  }

  /** Show what is known of `this.biobot` now; only what is new touches the document. */
  update({ nowS, rate, isLow }) {
    const { biobot } = this;
    const mode = modeOf(biobot);
    setText(this.mode, mode);
    setClass(this.mode, `mode ${mode}`);
    setHidden(this.mode, biobot.is_landmark);
    setHidden(this.place, !biobot.is_landmark);
    setText(this.cells.battery, biobot.battery_mv === null ? "–" : `${(biobot.battery_mv / 1000).toFixed(2)} V`);
    setClass(this.cells.battery, isLow ? "c-battery number low" : "c-battery number");
    setText(this.cells.rate, rate === null ? "–" : rate.toFixed(rate < 10 ? 1 : 0));
    setTitle(this.cells.rate, `${count(biobot.n_encounters)} encounters so far`);
    const { bars, words, more } = linkOf(biobot);
    setText(this.dbm, words);
    setClass(this.link, bars === null ? "link" : `link bars${bars}`);
    setTitle(this.link, more ?? "");
    setText(this.state, biobot.state);
    setClass(this.state, `state ${biobot.state}`);
    setClass(this.element, biobot.state);
    setTitle(this.element, biobot.is_reachable ? `through ${biobot.gateway}` : `gateway ${biobot.gateway} is away`);
    setText(this.cells.heard, age(silenceOf(biobot, nowS)));
  }

  /** Why an action cannot be asked for now, or null. */
  refusalOf(action) {
    return this.isUnderWay && action !== "stop" ? `Biobot ${this.key} has a command under way; only a stop can follow.` : null;
  }

  /** Say how far a command has come; while one is under way, only stops can be given. */
  showCommand({ isFine, step, text }, label) {
    this.isUnderWay = isFine === null;
    this.guarded.forEach((button) => this.account.review(button));
    this.steps.hidden = false;
    this.steps.className = `steps ${isFine === null ? "" : isFine ? "good" : "bad"}`;
    [...this.steps.children].forEach((dot, index) => {
      dot.className = index < step ? "done" : isFine === false && index === step ? "broken" : "";
    });
    const words = `${label}: ${text}`;
    this.steps.setAttribute("aria-label", words);
    this.steps.title = isFine === null ? `${words} (step ${step} of ${LAST_STEP}: ${STEPS[step]})` : words;
  }

  /** Take it off the page. */
  remove() {
    this.guarded.forEach((button) => this.account.forget(button));
    this.element.remove();
  }

  /** Put its buttons into the order of Tab, or take them out: one row is in it, the arrows go to others. */
  setReachable(isReachable) {
    [this.place, ...this.buttons].forEach((button) => {
      button.tabIndex = isReachable ? 0 : -1;
    });
  }
}
