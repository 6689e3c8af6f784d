// The newest commands of the site, whoever gave them: when, who, what, and what became of it.

import { describe } from "./commands.js";
import { make } from "./dom.js";
import { clock, secondsOf } from "./format.js";

const ACTIONS = { start: "start", stop: "stop", turn_left: "turn left", turn_right: "turn right", follow_walls: "follow walls", stop_all: "stop all" };

export class CommandHistory {
  constructor({ panel }) {
    this.list = make("ol", { className: "history" });
    this.empty = make("p", { className: "note" }, "None since the mapper started.");
    panel.append(make("section", { "aria-label": "Newest commands" }, make("h3", {}, "Newest commands"), this.empty, this.list));
  }

  show({ commands }) {
    this.empty.hidden = commands.length > 0;
    this.list.replaceChildren(...commands.map((command) => {
      const { isFine, text } = describe({ outcome: command.outcome, stage: command.stages.at(-1)?.stage, reason: command.reason, refusal: command.refusal });
      const whom = command.biobot === null ? "" : ` biobot ${command.biobot}`;
      return make("li", {},
        make("time", {}, clock(secondsOf(command.began_wall_ns))),
        make("span", { className: "what" }, make("strong", {}, `${ACTIONS[command.action] ?? command.action}${whom}`), command.operator ? ` by ${command.operator}` : ""),
        make("span", { className: isFine === null ? "" : isFine ? "good" : "bad" }, text));
    }));
  }
}
