// Commands to single biobots: given once, followed to their end, and told in words.

import { getJson, send } from "./net.js";

const WAIT_S = 20;
const PATIENCE_MS = 40_000;
const UNREACHED = "no answer from the mapper: nobody can tell whether it was carried out";
const STAGES = { accepted: "accepted by the gateway", radio_confirmed: "sent by the radio" };
const OUTCOMES = {
  biobot_confirmed: "confirmed by the biobot",
  refused: "refused",
  failed: "failed",
  unknown: "sent, but nobody can tell whether it was carried out",
  undelivered: "not delivered",
};

// What was refused by a limit that spares the animal (docs/stimulation.md).
const CARE = new Set(["gap", "trains", "on_time", "pulse"]);
const SPARED = "refused to spare the animal";

/** What to tell of an answer to a command, as it stands: {isFine, text}; isFine is null while it is under way. */
export function describe({ outcome, stage, reason, refusal }) {
  const words = CARE.has(refusal) ? SPARED : outcome ? OUTCOMES[outcome] ?? outcome : STAGES[stage] ?? "no answer yet";
  return { isFine: outcome ? outcome === "biobot_confirmed" : null, text: reason ? `${words}: ${reason}` : words };
}

/** How far it has come: 0 sent, 1 accepted, 2 sent by the radio, 3 confirmed by the biobot. */
export function stepOf({ outcome, stages }) {
  if (outcome === "biobot_confirmed") return 3;
  const told = new Set(stages.map(({ stage }) => stage));
  return told.has("radio_confirmed") ? 2 : told.has("accepted") ? 1 : 0;
}

/** Give a command and follow it to its end, telling each stage: {isFine, text, step}. Under one id, so that asking twice gives it once.
 * `more` is what else the request has: hold_ms, pulse. */
export async function giveCommand({ key, action, more = {}, onStage }) {
  let step = 0;
  try {
    let command = await send("POST", "/api/v1/commands", { biobot: key, action, ...more, id: crypto.randomUUID(), wait_s: 0 }, { tries: 2 });
    while (command.outcome === null) {
      step = stepOf(command);
      if (command.stages.length) onStage({ isFine: null, step, text: describe(command.stages.at(-1)).text });
      const path = `/api/v1/commands/${command.id}?wait_s=${WAIT_S}&seen=${command.stages.length}`;
      command = await getJson(path, { patienceMs: PATIENCE_MS });
    }
    return { ...describe(command), step: stepOf(command) };
  } catch (problem) {
    if (problem.status === undefined) throw problem;
    if (problem.status === 0) return { isFine: false, step, text: UNREACHED };
    const { outcome, reason, refusal } = problem.facts;
    return { isFine: false, step, text: outcome ? describe({ outcome, reason, refusal }).text : problem.text };
  }
}
