// Mission control: where the mission of each gateway stands, and the orders that can be given to it. What sets animals walking is asked back.

import { age, clock, count, secondsOf } from "./format.js";
import { make, makeButton, setClass, setText } from "./dom.js";
import { STEPS, nameOf, ordersIn, wordsOf } from "./mission_phases.js";
import { send } from "./net.js";

const TRIES = 2;

export class Mission {
  constructor({ panel, account, live }) {
    Object.assign(this, { account, live });
    this.blocks = new Map();
    this.list = make("div", { className: "missions" });
    this.empty = make("p", { className: "empty" }, "No gateway has been heard. Missions run on gateways.");
    panel.prepend(this.empty, this.list);
  }

  /** Show the missions of an answer of /api/v1/mission; `gateways` are all that are known, also without a mission. */
  show({ gateways: phases }, gateways) {
    const phaseOf = new Map(phases.map((phase) => [phase.gateway, phase]));
    const names = [...new Set([...phaseOf.keys(), ...gateways])].sort();
    this.empty.hidden = names.length > 0;
    for (const name of names) {
      if (!this.blocks.has(name)) {
        const block = new MissionBlock({ gateway: name, account: this.account, live: this.live });
        this.blocks.set(name, block);
        this.list.append(block.element);
      }
      this.blocks.get(name).show(phaseOf.get(name) ?? null);
    }
  }

  tick() {
    this.blocks.forEach((block) => block.tick());
  }
}

class MissionBlock {
  constructor({ gateway, account, live }) {
    Object.assign(this, { gateway, account, live });
    this.record = null;
    this.phase = "idle";
    this.steps = STEPS.map(({ label }) => make("li", {}, label));
    this.title = make("h3", {}, `Gateway ${gateway}`);
    this.words = make("p");
    this.facts = make("p", { className: "note" });
    this.buttons = new Map(["start", "pause", "resume", "next", "finish"].map((place) => {
      const button = makeButton("", () => this.press(place), { className: place });
      return [place, button];
    }));
    this.question = make("p", {});
    this.yes = makeButton("", () => this.give(this.asked), { className: "primary" });
    const no = makeButton("No", () => this.endQuestion());
    this.confirm = make("div", { className: "confirm", role: "group", tabIndex: -1, hidden: true }, this.question, this.yes, no);
    this.confirm.addEventListener("keydown", (event) => event.key === "Escape" && this.endQuestion());
    this.outcome = make("p", { className: "outcome", role: "status" });
    const group = make("div", { className: "orders", role: "group", "aria-label": `Orders to the mission of ${gateway}` }, ...this.buttons.values());
    this.element = make("section", { className: "mission-block", "aria-label": `Mission of ${gateway}` },
      this.title, make("ol", { className: "phases", "aria-label": "Phases" }, ...this.steps), this.words, this.facts, group, this.confirm, this.outcome);
    this.buttons.forEach((button, place) => account.guard(button, "operator", () => ordersIn(this.phase)[place].refusal));
    this.show(null);
  }

  show(record) {
    this.record = record;
    this.phase = record?.phase ?? "idle";
    const shown = this.phase === "paused" ? record.interrupted : this.phase;
    const at = STEPS.findIndex(({ phase }) => phase === shown);
    this.steps.forEach((step, index) => {
      setClass(step, `${index < at ? "past" : index === at ? "now" : "ahead"}${index === at && this.phase === "paused" ? " paused" : ""}`);
      if (index === at) step.setAttribute("aria-current", "step");
      else step.removeAttribute("aria-current");
    });
    setText(this.words, this.phase === "paused" ? `Paused in ${nameOf(shown)}. ${wordsOf("paused")}` : wordsOf(this.phase));
    const orders = ordersIn(this.phase);
    this.buttons.forEach((button, place) => {
      setText(button, orders[place].label);
      this.account.review(button);
    });
    if (!this.confirm.hidden && orders[this.asked]?.refusal) this.endQuestion();
    this.tick();
  }

  tick() {
    if (this.record === null) {
      setText(this.facts, "");
      return;
    }
    const { t_start_wall_ns: startNs, landmarks, round, operator, reason } = this.record;
    const began = secondsOf(startNs);
    const facts = [`since ${clock(began)} (${age(this.live.serverNow() - began)})`];
    if (round) facts.push(`round ${round}`);
    if (landmarks.length) facts.push(`${count(landmarks.length)} landmarks`);
    const ordered = operator ? `ordered by ${operator}` : "";
    if (ordered) facts.push(ordered);
    if (reason && reason !== ordered) facts.push(reason);
    setText(this.facts, facts.join(" · "));
  }

  press(place) {
    const { question, label } = ordersIn(this.phase)[place];
    this.asked = place;
    if (question === null) {
      this.give(place);
      return;
    }
    setText(this.question, question);
    setText(this.yes, `Yes: ${label.toLowerCase()}`);
    this.confirm.setAttribute("aria-label", question);
    this.confirm.hidden = false;
    this.confirm.focus();
  }

  endQuestion() {
    const hadFocus = this.confirm.contains(document.activeElement);
    this.confirm.hidden = true;
    if (hadFocus) this.buttons.get(this.asked).focus();
  }

  async give(place) {
    const { action, label } = ordersIn(this.phase)[place];
    this.endQuestion();
    this.tell(`${label}: sent …`, null);
    try {
      const order = await send("POST", "/api/v1/mission/orders", { action, gateway: this.gateway, id: crypto.randomUUID() }, { tries: TRIES });
      const [answer] = order.answers;
      this.tell(`${label}: taken by ${answer.gateway}, ${nameOf(answer.phase)}${answer.reason ? ` (${answer.reason})` : ""}`, true);
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      this.tell(`${label}: ${problem.text}`, false);
    }
  }

  tell(text, isFine) {
    this.outcome.textContent = text;
    setClass(this.outcome, `outcome ${isFine === null ? "" : isFine ? "good" : "bad"}`);
  }
}
