// One press stops every biobot at every gateway. No question is asked before, it may be pressed again at any time, and no role takes it away:
// it is always sent, and where the mapper refuses it, the page says so and what to do.

import { describe } from "./commands.js";
import { make } from "./dom.js";
import { getJson, send } from "./net.js";

const LOOK_MS = 400;
const LONGEST_S = 60;
const MAX_SHOWN = 30;
// More than these are named for who wants to know: on a phone the panel is small.
const MANY = 8;
const TRIES = 4;
const PATIENCE_MS = 5000;
const OTHERWISE = "On the machine of a gateway: biobot-gateway stop --all";

export class EmergencyStop {
  constructor({ button, panel, title, lines, close }) {
    Object.assign(this, { panel, title, lines });
    this.newest = null;
    button.addEventListener("click", () => this.press());
    addEventListener("keydown", (event) => {
      if (event.ctrlKey && event.shiftKey && event.code === "KeyX" && !event.repeat) {
        event.preventDefault();
        this.press();
      }
    }, { capture: true });
    close.addEventListener("click", () => {
      this.newest = null;
      panel.hidden = true;
      button.focus();
    });
  }

  async press() {
    const id = crypto.randomUUID();
    this.newest = id;
    this.panel.hidden = false;
    const at = new Date().toLocaleTimeString();
    this.show(`Stop of all, ${at}: sent …`, null, []);
    const begun = performance.now();
    let complaint = null;
    try {
      // The same id again is the same stop.
      await send("POST", "/api/v1/stop", { id }, { tries: TRIES, patienceMs: PATIENCE_MS });
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      if (problem.status !== 503) {
        if (this.newest === id) this.show(`Stop of all, ${at}: NOT stopped. ${problem.text}`, false, [{ isFine: false, text: OTHERWISE }]);
        return;
      }
      complaint = problem.detail;
    }
    while (this.newest === id) {
      const state = await this.look(id).catch(() => null);
      if (this.newest !== id) return;
      if (state === null) {
        this.show(`Stop of all, ${at}: ${complaint ?? "sent, but the mapper does not answer now"}`, false, [{ isFine: false, text: OTHERWISE }]);
      } else {
        const seconds = ((performance.now() - begun) / 1000).toFixed(1);
        const silent = state.answers.filter((answer) => answer.stage === null);
        const isOver = state.outcome !== null && !silent.length;
        const words = !state.answers.length ? complaint : silent.length ? `no answer from ${silent.map((answer) => answer.gateway).join(", ")}`
          : isOver ? describe(state).isFine ? "confirmed" : "not confirmed by all" : "under way";
        this.show(`Stop of all, ${at}: ${words} (${seconds} s)`, isOver ? describe(state).isFine : silent.length || complaint ? false : null, state.lines);
        if (isOver || performance.now() - begun > LONGEST_S * 1000) return;
      }
      await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    }
  }

  /** How the stop stands: its answers, and a line for each gateway and for the biobots. */
  async look(id) {
    const [command, parts] = await Promise.all([getJson(`/api/v1/commands/${id}`), getJson(`/api/v1/commands?part_of=${id}&limit=1000`)]);
    const lines = command.answers.map((answer) => ({ isFine: describe(answer).isFine, text: `${answer.gateway}: ${words(answer)}` }));
    const confirmed = parts.commands.filter((part) => part.outcome === "biobot_confirmed").map((part) => part.biobot);
    const others = parts.commands.filter((part) => part.outcome !== "biobot_confirmed").map((part) => part.biobot);
    const isMany = confirmed.length > MANY;
    if (confirmed.length) lines.push({ isFine: true, text: `confirmed by ${isMany ? number(confirmed) : named(confirmed)}`, more: isMany ? list(confirmed) : "" });
    // Whoever may walk on is named outright.
    if (others.length) lines.push({ isFine: command.outcome === null ? null : false, text: `not by ${named(others)}` });
    return { ...command, lines };
  }

  show(text, isFine, lines) {
    if (this.title.textContent !== text) this.title.textContent = text;
    this.panel.className = `stop-panel ${tone(isFine)}`;
    // What is said again is not spoken again, and what was opened stays open.
    const said = JSON.stringify(lines);
    if (said === this.said) return;
    this.said = said;
    const isOpen = this.lines.querySelector("details")?.open ?? false;
    this.lines.replaceChildren(...lines.map(({ isFine: isGood, text: words, more }) => {
      const line = more ? make("details", { open: isOpen }, make("summary", {}, words), more) : words;
      return make("li", { className: tone(isGood) }, line);
    }));
  }
}

function words(answer) {
  if (answer.outcome !== "biobot_confirmed") return describe(answer).text;
  return answer.reason ? `confirmed: ${answer.reason}` : "confirmed by all that can be reached";
}

function tone(isFine) {
  return isFine === null ? "" : isFine ? "good" : "bad";
}

function number(ids) {
  return ids.length === 1 ? `biobot ${ids[0]}` : `${ids.length} biobots`;
}

function named(ids) {
  return ids.length === 1 ? number(ids) : `${number(ids)}: ${list(ids)}`;
}

function list(ids) {
  return [...ids].sort((a, b) => a - b).slice(0, MAX_SHOWN).join(", ") + (ids.length > MAX_SHOWN ? ", …" : "");
}
