// The table of biobots: sorted, searched, and moved through by the arrow keys. Rows are changed in place, so that focus stays.

import { BiobotPanel } from "./biobot_panel.js";
import { countStates, isWanted, orderBy } from "./biobot_state.js";
import { giveCommand } from "./commands.js";
import { make, makeButton, setText } from "./dom.js";
import { age, count, secondsOf } from "./format.js";
import { COLUMNS, RosterRow } from "./roster_row.js";

const element = (id) => document.getElementById(id);

export class Roster {
  constructor({ account, live, onCounts, onPlace }) {
    Object.assign(this, { account, live, onCounts, onPlace });
    this.rows = new Map();
    this.rates = new Map();
    this.low = new Set();
    this.sorted = { column: "id", isDown: false };
    this.reachable = null;
    this.body = element("rows");
    this.panel = new BiobotPanel({ account, live, onCommand: (row, command) => this.command(row, command), onPlace });
    this.makeHead();
    element("filter").addEventListener("input", () => this.arrange());
    element("only").addEventListener("change", () => this.arrange());
    this.body.addEventListener("keydown", (event) => this.onKey(event));
    this.body.addEventListener("focusin", (event) => this.reach(this.rows.get(event.target.closest("tr").dataset.key)));
  }

  /** Show the biobots of an answer of /api/v1/biobots. */
  show({ biobots, now_wall_ns: nowNs, lost_after_s: lostAfterS }) {
    const nowS = this.live.serverNow(), toldS = secondsOf(nowNs);
    document.querySelectorAll(".lost-after").forEach((span) => setText(span, age(lostAfterS)));
    const gone = new Set(this.rows.keys());
    for (const biobot of biobots) {
      gone.delete(biobot.key);
      const row = this.rows.get(biobot.key) ?? this.addRow(biobot.key);
      this.update(row, { ...biobot, toldS }, nowS);
    }
    gone.forEach((key) => this.removeRow(key));
    this.arrange();
    this.tellCounts();
  }

  /** Learn how many encounters each has a minute, by key. */
  setRates(rates) {
    this.rates = rates;
    this.updateAll();
  }

  /** Learn whose battery is low: a set of keys. */
  setLow(low) {
    this.low = low;
    this.updateAll();
  }

  updateAll() {
    const nowS = this.live.serverNow();
    this.rows.forEach((row) => this.update(row, row.biobot, nowS));
    this.arrange();
  }

  update(row, biobot, nowS) {
    row.update(biobot, { nowS, rate: this.rates.get(row.key) ?? null, isLow: this.low.has(row.key) });
  }

  /** Show those of a kind alone ("": all). */
  showOnly(kind) {
    element("only").value = kind;
    element("filter").value = "";
    this.arrange();
    element("only").focus();
  }

  /** Show one biobot alone, and give its row the focus. */
  find(key) {
    element("only").value = "";
    element("filter").value = key;
    this.arrange();
    const row = this.rows.get(key);
    if (!row) return;
    this.reach(row);
    row.buttons[0].focus();
  }

  tick() {
    const nowS = this.live.serverNow();
    this.rows.forEach((row) => row.tick(nowS));
    this.panel.refresh();
  }

  tellCounts() {
    this.onCounts(countStates([...this.rows.values()].map((row) => row.biobot)), this.rows.size);
  }

  makeHead() {
    const cells = COLUMNS.map(({ name, label, isNumber, more }) => {
      const button = makeButton(label, () => this.sortBy(name), { title: more ?? "" });
      return make("th", { scope: "col", role: "columnheader", className: `c-${name}${isNumber ? " number" : ""}` }, button);
    });
    element("columns").append(...cells, make("th", { scope: "col", role: "columnheader", className: "c-commands" }, "command"));
    this.showSorted();
  }

  sortBy(column) {
    this.sorted = { column, isDown: this.sorted.column === column && !this.sorted.isDown };
    this.showSorted();
    this.arrange();
  }

  showSorted() {
    [...element("columns").children].slice(0, COLUMNS.length).forEach((cell, index) => {
      const isSorted = COLUMNS[index].name === this.sorted.column;
      if (isSorted) cell.setAttribute("aria-sort", this.sorted.isDown ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
  }

  /** The rows in their order. As long as somebody points at the table or is in it, none moves: a press must not meet another biobot. */
  inOrder(nowS) {
    const rows = [...this.rows.values()];
    if (this.body.matches(":hover, :focus-within")) {
      const places = new Map([...this.body.children].map((element, place) => [element, place]));
      return rows.sort((a, b) => (places.get(a.element) ?? rows.length) - (places.get(b.element) ?? rows.length));
    }
    const compare = orderBy(this.sorted.column, { nowS, rates: this.rates });
    rows.sort((a, b) => compare(a.biobot, b.biobot));
    return this.sorted.isDown ? rows.reverse() : rows;
  }

  /** Bring the rows into order and hide those that are not looked for; what is in its place stays untouched. */
  arrange() {
    const rows = this.inOrder(this.live.serverNow());
    let place = this.body.firstElementChild;
    for (const row of rows) {
      if (row.element === place) place = place.nextElementSibling;
      else this.body.insertBefore(row.element, place);
    }
    const words = element("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const kind = element("only").value;
    this.shown = rows.filter((row) => isWanted(row.biobot, { words, kind, low: this.low }));
    const shown = new Set(this.shown);
    rows.forEach((row) => {
      row.element.hidden = !shown.has(row);
    });
    element("no-rows").hidden = shown.size > 0;
    element("no-rows").textContent = rows.length ? "No biobot is like that." : "No gateway has reported a biobot yet.";
    const told = words.length || kind ? `${count(shown.size)} of ${count(rows.length)}` : "";
    if (element("shown").textContent !== told) element("shown").textContent = told;
    if (!shown.has(this.reachable)) this.reach(this.shown[0] ?? null);
  }

  addRow(key) {
    const onCommand = (row, action, label) => this.command(row, { action, label });
    const onMore = (row, opener) => this.panel.open(row, opener);
    const row = new RosterRow({ key, onCommand, onMore, onPlace: this.onPlace, account: this.account });
    this.rows.set(key, row);
    return row;
  }

  removeRow(key) {
    this.panel.closeFor(this.rows.get(key));
    this.rows.get(key).remove();
    this.rows.delete(key);
  }

  reach(row) {
    if (row === this.reachable) return;
    this.reachable?.setReachable(false);
    this.reachable = row;
    row?.setReachable(true);
  }

  onKey(event) {
    const row = this.rows.get(event.target.closest("tr").dataset.key);
    const at = this.shown.indexOf(row);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, PageDown: at + 10, PageUp: at - 10, Home: 0, End: this.shown.length - 1 }[event.key];
    if (to === undefined || at < 0) return;
    event.preventDefault();
    const next = this.shown[Math.min(Math.max(to, 0), this.shown.length - 1)];
    this.reach(next);
    next.buttons[Math.max(row.buttons.indexOf(event.target), 0)].focus();
  }

  /** Give a command and show its stages in the row and in words, here and by `tell`. */
  async command(row, { action, label, more, tell = () => {} }) {
    const begun = performance.now();
    const show = (stage, words) => {
      row.showCommand(stage, label);
      [(text) => this.tell(text, stage.isFine), (text) => tell(text, stage.isFine)].forEach((told) => told(`${label}: ${words}`));
    };
    const onStage = (stage) => show(stage, `${stage.text} …`);
    onStage({ isFine: null, step: 0, text: "sent" });
    const end = await giveCommand({ key: row.key, action, more, onStage });
    show(end, `${end.text} (${((performance.now() - begun) / 1000).toFixed(1)} s)`);
    this.panel.refresh();
  }

  tell(text, isFine) {
    element("outcome").textContent = text;
    element("outcome").className = `outcome ${isFine === null ? "" : isFine ? "good" : "bad"}`;
  }
}
