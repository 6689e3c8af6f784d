// The table of biobots: sorted, searched, and moved through by the arrow keys. Rows are changed in place, so that focus stays, and not all in
// one frame: there may be hundreds.

import { BiobotPanel } from "./biobot_panel.js";
import { countStates, isWanted, orderBy } from "./biobot_state.js";
import { giveCommand } from "./commands.js";
import { make, makeButton, setHidden, setText } from "./dom.js";
import { age, count, secondsOf } from "./format.js";
import { reorder } from "./row_order.js";
import { RowPainter } from "./row_painter.js";
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
    Object.assign(this, { shown: [], mustArrange: false, isWaiting: false, moving: null });
    this.body = element("rows");
    this.panel = new BiobotPanel({ account, live, onCommand: (row, command) => this.command(row, command), onPlace });
    this.painter = new RowPainter({ paint: (row) => this.paint(row) });
    this.makeHead();
    element("filter").addEventListener("input", () => this.arrangeAnew());
    element("only").addEventListener("change", () => this.arrangeAnew());
    this.body.addEventListener("keydown", (event) => this.onKey(event));
    this.body.addEventListener("focusin", (event) => this.reach(this.rows.get(event.target.closest("tr").dataset.key)));
  }

  /** Show the biobots of an answer of /api/v1/biobots. */
  show({ biobots, now_wall_ns: nowNs, lost_after_s: lostAfterS }) {
    const toldS = secondsOf(nowNs);
    document.querySelectorAll(".lost-after").forEach((span) => setText(span, age(lostAfterS)));
    const gone = new Set(this.rows.keys());
    for (const biobot of biobots) {
      gone.delete(biobot.key);
      const row = this.rows.get(biobot.key);
      if (row) row.biobot = { ...biobot, toldS };
      else this.addRow({ ...biobot, toldS });
    }
    gone.forEach((key) => this.removeRow(key));
    this.refresh();
    this.tellCounts();
  }

  /** Learn how many encounters each has a minute, by key. */
  setRates(rates) {
    this.rates = rates;
    this.refresh();
  }

  /** Learn whose battery is low: a set of keys. */
  setLow(low) {
    this.low = low;
    this.refresh();
  }

  refresh() {
    this.painter.refresh();
    this.arrangeSoon();
  }

  paint(row) {
    row.update({ nowS: this.live.serverNow(), rate: this.rates.get(row.key) ?? null, isLow: this.low.has(row.key) });
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
    this.painter.refresh();
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
    this.arrangeAnew();
  }

  showSorted() {
    [...element("columns").children].slice(0, COLUMNS.length).forEach((cell, index) => {
      const isSorted = COLUMNS[index].name === this.sorted.column;
      if (isSorted) cell.setAttribute("aria-sort", this.sorted.isDown ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
  }

  /** Somebody points at the table or is in it: then no row moves, because a press must not meet another biobot. */
  isBusy() {
    return this.body.matches(":hover, :focus-within");
  }

  asTheyLie() {
    const places = new Map([...this.body.children].map((element, place) => [element, place]));
    return [...this.rows.values()].sort((a, b) => places.get(a.element) - places.get(b.element));
  }

  inOrder(nowS) {
    const compare = orderBy(this.sorted.column, { nowS, rates: this.rates });
    const rows = [...this.rows.values()].sort((a, b) => compare(a.biobot, b.biobot));
    return this.sorted.isDown ? rows.reverse() : rows;
  }

  /** Arrange the rows in the next frame, once for whatever asks for it until then. */
  arrangeSoon() {
    this.mustArrange = true;
    this.wake();
  }

  /** Somebody wants them otherwise: what is under way does not count any more. */
  arrangeAnew() {
    this.moving = null;
    this.arrangeSoon();
  }

  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => {
      this.isWaiting = false;
      // What is under way goes on first: rows that always change must not keep the last ones from their places.
      if (this.moving) this.move();
      else if (this.mustArrange) this.arrange();
    });
  }

  /** Hide the rows that are not looked for, and begin to bring all into order. */
  arrange() {
    const isBusy = this.isBusy();
    const rows = isBusy ? this.asTheyLie() : this.inOrder(this.live.serverNow());
    const words = element("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const kind = element("only").value;
    this.mustArrange = false;
    this.shown = rows.filter((row) => isWanted(row.biobot, { words, kind, low: this.low }));
    const shown = new Set(this.shown);
    rows.forEach((row) => setHidden(row.element, !shown.has(row)));
    element("no-rows").hidden = shown.size > 0;
    setText(element("no-rows"), rows.length ? "No biobot is like that." : "No gateway has reported a biobot yet.");
    setText(element("shown"), words.length || kind ? `${count(shown.size)} of ${count(rows.length)}` : "");
    if (!shown.has(this.reachable)) this.reach(this.shown[0] ?? null);
    this.moving = isBusy ? null : reorder(this.body, rows.map((row) => row.element));
    this.move();
  }

  /** Move some rows, the others in the next frames; where somebody has come to the table meanwhile, what is moved is moved. */
  move() {
    if (this.moving && this.isBusy()) {
      this.moving = null;
      this.mustArrange = true;
    }
    if (this.moving?.next().done) this.moving = null;
    if (this.moving || this.mustArrange) this.wake();
  }

  addRow(biobot) {
    const onCommand = (row, action, label) => this.command(row, { action, label });
    const onMore = (row, opener) => this.panel.open(row, opener);
    const row = new RosterRow({ biobot, onCommand, onMore, onPlace: this.onPlace, account: this.account });
    this.rows.set(row.key, row);
    this.paint(row);
    this.body.append(row.element);
    this.painter.add(row);
  }

  removeRow(key) {
    const row = this.rows.get(key);
    this.panel.closeFor(row);
    this.painter.remove(row);
    row.remove();
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
