// Phases of a mission and the orders that are possible in each (docs/mission.md), in words for those who give them. Pure.

export const STEPS = [
  { phase: "dispersion", label: "Dispersion" },
  { phase: "landmark_selection", label: "Landmarks" },
  { phase: "exploration", label: "Exploration" },
  { phase: "done", label: "Done" },
];

const NAMES = { idle: "no mission", dispersion: "dispersion", landmark_selection: "choosing landmarks", exploration: "exploration", paused: "paused", done: "done" };

const WORDS = {
  idle: "No mission has begun. Biobots do as they like.",
  dispersion: "All biobots walk and spread out. The map begins after this.",
  landmark_selection: "Some biobots are told to stand still: they become the landmarks.",
  exploration: "Landmarks stand, the others walk and meet. The map grows.",
  paused: "Nobody is commanded. Biobots go on as they are, or stand since a stop of all.",
  done: "The mission is over. Landmarks stay where they are.",
};

const NEXT = {
  dispersion: { action: "select", label: "Next: landmarks", question: null },
  landmark_selection: { action: "redisperse", label: "New round", question: "Let all biobots walk again, and choose other landmarks afterwards?" },
  exploration: { action: "redisperse", label: "New round", question: "Let the landmarks walk again, and choose others after a dispersion? The map begins anew." },
};

export function nameOf(phase) {
  return NAMES[phase] ?? phase;
}

export function wordsOf(phase) {
  return WORDS[phase] ?? "";
}

/** The five orders as they stand in a phase: {action, label, question, refusal}; a question is asked before, a refusal says why it cannot be. */
export function ordersIn(phase) {
  const isOn = ["dispersion", "landmark_selection", "exploration"].includes(phase);
  const isOver = phase === "idle" || phase === "done";
  const now = `The mission is now: ${nameOf(phase)}.`;
  const next = NEXT[phase];
  return {
    start: { action: "start", label: "Start", question: "Start the mission? All biobots begin to walk.", refusal: isOver ? null : `${now} It has begun already.` },
    pause: { action: "pause", label: "Pause", question: null, refusal: isOn || phase === "idle" ? null : `${now} There is nothing to pause.` },
    resume: {
      action: "resume", label: "Resume", question: "Go on? Biobots that a stop of all halted begin to walk again.", refusal: phase === "paused" ? null : `${now} Only a paused one is resumed.`,
    },
    next: { action: "select", label: "Next", question: null, ...next, refusal: next ? null : `${now} Nothing comes next by order.` },
    finish: {
      action: "finish", label: "End", question: "End the mission for good? Landmarks stay where they are; another start begins anew.",
      refusal: isOn || phase === "paused" ? null : `${now} There is nothing to end.`,
    },
  };
}
