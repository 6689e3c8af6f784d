// Numbers as people read them.

const NS_PER_S = 1e9;
const COUNTS = new Intl.NumberFormat("en");

export function age(seconds) {
  if (seconds === null || !Number.isFinite(seconds)) return "–";
  const s = Math.max(0, seconds);
  if (s < 1.5) return "now";
  if (s < 90) return `${Math.round(s)} s`;
  if (s < 5400) return `${Math.round(s / 60)} min`;
  if (s < 172800) return `${Math.round(s / 3600)} h`;
  return `${Math.round(s / 86400)} d`;
}

export function length(value, unit) {
  return `${Number(value.toPrecision(3))} ${unit}`;
}

/** A probability; nothing is told of as certain. */
export function percent(share) {
  return share > 0.99 ? "over 99 %" : share < 0.01 ? "under 1 %" : `${Math.round(100 * share)} %`;
}

/** The same in few characters. */
export function shortPercent(share) {
  return percent(share).replace("over", ">").replace("under", "<");
}

export function count(value) {
  return COUNTS.format(value);
}

export function secondsOf(nanoseconds) {
  return nanoseconds === null ? null : nanoseconds / NS_PER_S;
}

export function clock(unixSeconds) {
  return new Date(unixSeconds * 1000).toLocaleTimeString();
}

/** A round number not above `target`: 1, 2 or 5 times a power of ten. */
export function roundBelow(target) {
  const power = 10 ** Math.floor(Math.log10(target));
  return [5, 2, 1].map((digit) => digit * power).find((value) => value <= target) ?? power;
}

/** Read colours of the style sheet, which knows whether the scheme is light or dark. */
export function palette(...names) {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}
