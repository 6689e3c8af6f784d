// What is said of a biobot, from what the mapper knows of it. Pure: the time is an argument.

// dBm; a CC2530 hears down to about -97 (data sheet SWRS081, typical), so that the last step has 12 dB of margin.
const STRONG_DBM = -65;
const FAIR_DBM = -75;
const WEAK_DBM = -85;

const NAMES = { walking: "walking", landmark: "landmark", halted: "stopped", still: "still" };

/** Seconds since it was heard, or null if it never was; `toldS` is when the mapper told of it, by the mapper's clock. */
export function silenceOf(biobot, nowS) {
  return biobot.silence_s === null ? null : biobot.silence_s + Math.max(0, nowS - biobot.toldS);
}

export function modeOf(biobot) {
  if (biobot.is_landmark) return NAMES.landmark;
  if (biobot.mode !== "S") return NAMES.walking;
  return biobot.is_halted ? NAMES.halted : NAMES.still;
}

/** {bars, words, more}: 1 to 4 bars, the signal [dBm], and all in words; bars null where nobody has told. */
export function linkOf(biobot) {
  const { rssi_dbm: rssi, lqi } = biobot;
  if (rssi === null) return { bars: null, words: "–" };
  const bars = rssi > STRONG_DBM ? 4 : rssi > FAIR_DBM ? 3 : rssi > WEAK_DBM ? 2 : 1;
  return { bars, words: `${rssi} dBm`.replace("-", "−"), more: `received at ${rssi} dBm${lqi === null ? "" : `, link quality ${lqi} of 255`}` };
}

/** How many are in each state. */
export function countStates(biobots) {
  const counts = { online: 0, lost: 0, unknown: 0 };
  biobots.forEach(({ state }) => counts[state]++);
  return counts;
}

/** Whether a biobot is one of those that are looked for: by words, each of which begins its id, state, mode, or gateway; and by a
 * kind. `low` are the keys of those whose battery is low. */
export function isWanted(biobot, { words, kind, low }) {
  const { state } = biobot, mode = modeOf(biobot);
  const isOfKind = { "": true, low: low.has(biobot.key), still: mode === "still" || mode === "stopped" }[kind] ?? (kind === state || kind === mode);
  return isOfKind && words.every((word) => [biobot.key, state, mode, biobot.gateway].some((text) => text.toLowerCase().startsWith(word)));
}

const BY_ID = (a, b) => a.key.length - b.key.length || (a.key < b.key ? -1 : a.key > b.key ? 1 : 0);
const STATES = ["lost", "unknown", "online"];
const number = (value) => value ?? Number.NEGATIVE_INFINITY;

/** Comparisons by column; `rates` are encounters per minute by key. Ids are compared as text: they may have 64 bits. */
export function orderBy(column, { nowS, rates }) {
  const values = {
    state: ({ state }) => STATES.indexOf(state),
    mode: modeOf,
    battery: (biobot) => number(biobot.battery_mv),
    heard: (biobot) => number(silenceOf(biobot, nowS)),
    rate: (biobot) => number(rates.get(biobot.key)),
    link: (biobot) => number(biobot.rssi_dbm),
  };
  const value = values[column];
  if (!value) return BY_ID;
  return (a, b) => {
    const [x, y] = [value(a), value(b)];
    return x < y ? -1 : x > y ? 1 : BY_ID(a, b);
  };
}
