// One biobot: all that is known of it, how it was stimulated, and the commands that are not needed every minute: to follow walls, to move
// for a while only, a pulse train of its own. What spares the animal is the gateway's table of limits; what it refuses is told as that.

import { linkOf, modeOf, silenceOf } from "./biobot_state.js";
import { make, makeButton, setText } from "./dom.js";
import { age, count } from "./format.js";
import { getJson } from "./net.js";
import { Panel } from "./panel.js";

const MS_PER_S = 1000;
const ACTIONS = [
  { action: "follow_walls", words: "follow walls", name: (key) => `Let biobot ${key} follow walls` },
  { action: "start", words: "walk", name: (key) => `Start biobot ${key}` },
  { action: "turn_left", words: "turn left", name: (key) => `Turn biobot ${key} left` },
  { action: "turn_right", words: "turn right", name: (key) => `Turn biobot ${key} right` },
];
const STOP = { action: "stop", name: (key) => `Stop biobot ${key}` };
// Ranges are those of the wire; what an animal may get is narrower, and the gateway says so.
const PULSE = [
  { name: "amplitude_mv", label: "amplitude [mV]", min: 0, max: 65535 },
  { name: "frequency_hz", label: "frequency [Hz]", min: 1, max: 255 },
  { name: "pulse_width_us", label: "pulse width [µs]", min: 1, max: 65535 },
  { name: "duration_ms", label: "length [ms]", min: 0, max: 65535 },
  { name: "channel", label: "channel", min: 0, max: 255 },
];
const WAVEFORMS = ["symmetric", "asymmetric", "monophasic"];

export class BiobotPanel {
  /** `onCommand(row, {action, label, more, tell})` gives a command and is done at its end; `onPlace(place)` shows where it was. */
  constructor({ account, live, onCommand, onPlace }) {
    Object.assign(this, { account, live, onCommand });
    this.row = null;
    this.title = make("h2", { id: "biobot-title", tabIndex: -1, "data-first": "" });
    const close = makeButton("Close", () => {}, { "data-close": "" });
    this.facts = make("dl", { className: "facts" });
    const place = makeButton("Where it met somebody last", () => {
      const { key } = this.row;
      this.panel.close();  // on a phone it lies over the map
      onPlace(`biobot:${key}`);
    });
    this.care = make("dl", { className: "facts" });
    this.outcome = make("p", { id: "biobot-outcome", className: "outcome", role: "status" });
    this.element = make("section", { id: "biobot-panel", className: "panel", role: "dialog", "aria-labelledby": "biobot-title", hidden: true },
      make("div", { className: "panel-head" }, this.title, close), this.facts, place, make("h3", {}, "Stimulation"), this.care, make("h3", {}, "Command"), this.makeForm(), this.outcome);
    document.getElementById("help").after(this.element);
    this.panel = new Panel({ panel: this.element, onClose: () => this.leave() });
  }

  makeForm() {
    this.action = make("select", { id: "biobot-action" }, ...ACTIONS.map(({ action, words }) => make("option", { value: action }, words)));
    this.hold = make("input", { id: "biobot-hold", type: "number", min: "0.1", max: "3600", step: "0.1", placeholder: "goes on" });
    this.fields = Object.fromEntries(PULSE.map(({ name, min, max }) => [name, make("input", { id: `biobot-${name}`, type: "number", min: String(min), max: String(max), step: "1", placeholder: "as set" })]));
    this.fields.waveform = make("select", { id: "biobot-waveform" }, make("option", { value: "" }, "as set"), ...WAVEFORMS.map((name) => make("option", {}, name)));
    const labelled = (text, field) => make("label", { className: "field" }, make("span", {}, text), field);
    const pulse = make("details", {}, make("summary", {}, "A pulse train of its own"),
      make("div", { className: "pulse" }, ...PULSE.map(({ name, label }) => labelled(label, this.fields[name])), labelled("waveform", this.fields.waveform)),
      make("p", { className: "note" }, "What is left empty is as the gateway has it. Beyond its limits, or the backpack's, it is refused."));
    this.send = make("button", { type: "submit", className: "primary" });
    this.stop = makeButton("", () => this.give(STOP, {}), { className: "stop" });
    this.account.guard(this.stop, "operator");
    this.account.guard(this.send, "operator", () => this.row?.refusalOf(this.action.value) ?? null);
    const form = make("form", { className: "biobot-form" }, labelled("what", this.action), labelled("stop after [s]", this.hold), pulse, this.send, this.stop);
    this.action.addEventListener("change", () => this.refresh());
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.give(this.chosen(), this.wanted());
    });
    return form;
  }

  /** Open it for a row of the table; `opener` gets the focus back. */
  open(row, opener) {
    this.row = row;
    this.tell("", null);
    this.care.replaceChildren(make("div", {}, make("dd", {}, "…")));
    this.panel.open(opener);
    this.refresh();
    this.refreshCare();
  }

  /** Close it if it is that of a row that goes. */
  closeFor(row) {
    if (this.row === row) this.panel.close();
  }

  leave() {
    this.row = null;
  }

  /** Show what is known now, if it is open. */
  refresh() {
    if (this.row === null) return;
    const { key, biobot } = this.row;
    setText(this.title, `Biobot ${key}`);
    setText(this.send, this.chosen().name(key));
    setText(this.stop, STOP.name(key));
    this.account.review(this.send);
    const silence = silenceOf(biobot, this.live.serverNow());
    const { words } = linkOf(biobot);
    const { radio, dropped, buffered } = biobot;
    fill(this.facts, [
      ["state", `${biobot.state}, ${silence === null ? "not heard yet" : `heard ${age(silence)}${silence < 1.5 ? "" : " ago"}`}`],
      ["does", modeOf(biobot)],
      ["through", `gateway ${biobot.gateway}${radio ? `, ${radio.replace(/^.*\//, "")}` : ""}${biobot.rssi_dbm === null ? "" : `, ${words}`}`],
      ["battery", biobot.battery_mv === null ? "not told" : `${(biobot.battery_mv / 1000).toFixed(2)} V`],
      ["met", `${count(biobot.n_encounters)} encounters${biobot.n_neighbours === null ? "" : `, ${count(biobot.n_neighbours)} near it now`}`],
      ...(buffered ? [["keeps", `${count(buffered)} ${buffered === 1 ? "report" : "reports"} that no gateway has yet`]] : []),
      ...(dropped ? [["dropped", `${count(dropped)} reports: its memory was full`]] : []),
    ]);
  }

  /** Ask how it was stimulated so far, and when the next train would be admitted. */
  async refreshCare() {
    const { row } = this;
    if (row === null) return;
    let accounts;
    try {
      ({ accounts } = await getJson(`/api/v1/biobots/${row.key}/stimulation`));
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      if (this.row === row) fill(this.care, [["", problem.text]]);
      return;
    }
    if (this.row !== row) return;
    fill(this.care, accounts.length ? accounts.flatMap((account) => this.careOf(account, accounts.length > 1)) : [["", "None that a gateway told of."]]);
  }

  careOf(account, isOneOfMany) {
    const readyS = account.ready_wall_ns / 1e9 - this.live.serverNow();
    return [
      ...(isOneOfMany ? [["gateway", account.gateway]] : []),
      ["so far", `${trains(account.n_trains)}, ${seconds(account.on_ms)} in all`],
      [`last ${account.window_s} s`, `${trains(account.n_trains_in_window)}, ${seconds(account.on_ms_in_window)}`],
      ["next train", readyS > 0.1 ? `not before ${readyS.toFixed(1)} s from now` : "admitted now"],
      ["obeyed", account.n_answerable ? `${count(account.n_obeyed)} of ${count(account.n_answerable)} that show` : "nothing that shows yet"],
      ["used to it", `${Math.round(100 * account.habituation)} % (an estimate)`],
      ...(account.n_refused ? [["refused", `${count(account.n_refused)} of ${count(account.n_commands)} commands`]] : []),
      ...(account.controlled_by ? [["moved by", account.controlled_by]] : []),
    ];
  }

  chosen() {
    return ACTIONS.find(({ action }) => action === this.action.value);
  }

  /** What of the form goes along with the action. */
  wanted() {
    const more = {};
    if (this.hold.value) more.hold_ms = Math.round(this.hold.valueAsNumber * MS_PER_S);
    const given = Object.entries(this.fields).filter(([, field]) => field.value !== "");
    if (given.length) more.pulse = Object.fromEntries(given.map(([name, field]) => [name, name === "waveform" ? field.value : field.valueAsNumber]));
    return more;
  }

  async give({ action, name }, more) {
    const { row } = this;
    const label = name(row.key) + (more.hold_ms ? ` for ${seconds(more.hold_ms)}` : "");
    const tell = (text, isFine) => this.row === row && this.tell(text, isFine);
    await this.onCommand(row, { action, label, more, tell });
    await this.refreshCare();
  }

  tell(text, isFine) {
    setText(this.outcome, text);
    this.outcome.className = `outcome ${isFine === null ? "" : isFine ? "good" : "bad"}`;
  }
}

function fill(list, pairs) {
  list.replaceChildren(...pairs.map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))));
}

function trains(n) {
  return n === 1 ? "1 train" : `${count(n)} trains`;
}

function seconds(ms) {
  return `${Number((ms / MS_PER_S).toFixed(1))} s`;
}
