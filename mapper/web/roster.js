// The table of biobots. Rows are changed in place, so that focus and selection stay while states come in.

import { age, count, secondsOf } from "./format.js";
import { sendCommand } from "./net.js";

// The CC2530 runs from 2.0 V on (data sheet SWRS081); this leaves time to act.
const LOW_BATTERY_MV = 2200;
const LOST_AFTER_S = 60;

export class Roster {
  constructor({ body, empty, filter, outcome }) {
    Object.assign(this, { body, empty, filter, outcome });
    this.rows = new Map();
    this.clockOffsetS = 0;
    this.biobots = [];
    filter.addEventListener("input", () => this.applyFilter());
  }

  show({ biobots, now_wall_ns }) {
    this.clockOffsetS = secondsOf(now_wall_ns) - Date.now() / 1000;
    this.biobots = biobots;
    const gone = new Set(this.rows.keys());
    let place = this.body.firstElementChild;
    for (const biobot of biobots) {
      gone.delete(biobot.key);
      const row = this.rows.get(biobot.key) ?? this.addRow(biobot.key);
      if (row.element !== place) this.body.insertBefore(row.element, place);
      place = row.element.nextElementSibling;
      row.biobot = biobot;
      this.update(row);
    }
    for (const key of gone) {
      this.rows.get(key).element.remove();
      this.rows.delete(key);
    }
    this.applyFilter();
  }

  tick() {
    for (const row of this.rows.values()) this.updateAge(row);
  }

  addRow(key) {
    const element = document.createElement("tr");
    const cells = Object.fromEntries(["id", "mode", "battery", "heard", "encounters", "command"].map((name) => [name, element.insertCell()]));
    cells.id.textContent = key;
    cells.encounters.className = "number";
    const modeLabel = document.createElement("span");
    cells.mode.append(modeLabel);
    const actions = document.createElement("div");
    actions.className = "actions";
    const buttons = ["start", "stop"].map((action) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = action;
      button.textContent = action === "stop" ? "Stop" : "Start";
      button.setAttribute("aria-label", `${button.textContent} biobot ${key}`);
      button.addEventListener("click", () => this.command(row, action));
      return button;
    });
    actions.append(...buttons);
    cells.command.append(actions);
    const row = { element, cells, modeLabel, buttons, biobot: null };
    this.rows.set(key, row);
    return row;
  }

  update(row) {
    const { biobot, cells } = row;
    const name = biobot.is_landmark ? "landmark" : biobot.mode !== "S" ? "walking" : biobot.is_halted ? "stopped" : "still";
    setText(row.modeLabel, name);
    row.modeLabel.className = `mode ${name}`;
    setText(cells.battery, biobot.battery_mv === null ? "–" : `${(biobot.battery_mv / 1000).toFixed(2)} V`);
    cells.battery.classList.toggle("low", biobot.battery_mv !== null && biobot.battery_mv < LOW_BATTERY_MV);
    setText(cells.encounters, count(biobot.n_encounters));
    row.element.classList.toggle("away", !biobot.is_reachable);
    row.element.title = biobot.is_reachable ? `through ${biobot.gateway}` : `gateway ${biobot.gateway} is away`;
    this.updateAge(row);
  }

  updateAge({ biobot, cells }) {
    const seconds = biobot.last_heard_wall_ns === null ? null : Date.now() / 1000 + this.clockOffsetS - secondsOf(biobot.last_heard_wall_ns);
    setText(cells.heard, age(seconds));
    cells.heard.classList.toggle("low", seconds !== null && seconds > LOST_AFTER_S);
  }

  applyFilter() {
    const wanted = this.filter.value.trim().toLowerCase();
    let n = 0;
    for (const { element, biobot, modeLabel } of this.rows.values()) {
      element.hidden = wanted !== "" && !biobot.key.startsWith(wanted) && !modeLabel.textContent.startsWith(wanted);
      n += !element.hidden;
    }
    this.empty.hidden = n > 0;
    this.empty.textContent = this.rows.size ? "No biobot is like that." : "No gateway has reported a biobot yet.";
  }

  async command(row, action) {
    const label = `${action === "stop" ? "Stop" : "Start"} biobot ${row.biobot.key}`;
    // A second press of Start would be a second stimulus; Stop may be pressed as often as one likes.
    const start = row.buttons[0];
    start.disabled = true;
    this.tell(`${label}: sent …`, null);
    const begun = performance.now();
    const onStage = (stage) => this.tell(`${label}: ${stage} …`, null);
    const { isFine, text } = await sendCommand({ key: row.biobot.key, action, onStage });
    start.disabled = false;
    this.tell(`${label}: ${text} (${((performance.now() - begun) / 1000).toFixed(1)} s)`, isFine);
  }

  tell(text, isFine) {
    this.outcome.textContent = text;
    this.outcome.className = `outcome ${isFine === null ? "" : isFine ? "good" : "bad"}`;
  }
}

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
