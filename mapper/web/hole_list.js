// Holes as a table that can be read, walked through by keyboard and heard: each is marked on the map and in the diagram as one comes to it.

import { make } from "./dom.js";
import { shortPercent } from "./format.js";
import { LEAST_DRAWN } from "./map_scene.js";

export class HoleList {
  /** `onHover(chosen | null)`, `onKeep(chosen)`; chosen: {hole} or {possible}. */
  constructor(root, { onHover, onKeep }) {
    Object.assign(this, { root, onHover, onKeep });
    this.rows = [];
  }

  show(map) {
    const focused = document.activeElement?.closest?.("[data-row]")?.dataset.row;
    const unit = map.frame ? "m" : map.parameters.length_unit;
    const isEnough = map.data?.is_enough !== false;
    const listed = [
      ...map.holes.map((hole, index) => ({ hole: inFrame(map, hole, index), chosen: { hole: index }, name: isEnough ? `Hole ${index + 1}` : `Hole ${index + 1}?` })),
      ...(map.possible_holes ?? []).map((hole, index) => ({ hole, chosen: { possible: index }, name: "Possible" })).filter(({ hole }) => hole.probability >= LEAST_DRAWN),
    ];
    this.rows = listed.map(({ hole, chosen, name }) => ({ chosen, element: this.makeRow(hole, chosen, name, unit) }));
    if (!listed.length) {
      this.root.replaceChildren(make("p", { className: "empty" }, isEnough ? "No hole: as far as biobots met, there is nothing that they walked around." : "No hole can be told yet."));
      return;
    }
    const head = make("tr", {}, ...["hole", "sure", `area ${unit}²`, `around ${unit}`].map((word, i) => make("th", { scope: "col", className: i ? "number" : "" }, word)));
    const body = make("tbody", {}, ...this.rows.map(({ element }) => element));
    this.root.replaceChildren(make("table", { "aria-label": "Holes of the map" }, make("thead", {}, head), body));
    if (focused) this.root.querySelector(`[data-row="${focused}"] button`)?.focus({ preventScroll: true });
  }

  makeRow(hole, chosen, name, unit) {
    const key = "hole" in chosen ? `h${chosen.hole}` : `p${chosen.possible}`;
    const button = make("button", {
      type: "button", className: "plain", "aria-pressed": "false", title: "Bring it into sight on the map",
      onfocus: () => this.onHover(chosen), onblur: () => this.onHover(null), onclick: () => this.onKeep(chosen),
    }, name);
    const told = (value, error) => (value == null ? "–" : error == null ? `${round(value)}` : `${round(value)} ± ${round(error)}`);
    return make("tr", { "data-row": key, className: "hole" in chosen ? "" : "possible", onpointerenter: () => this.onHover(chosen), onpointerleave: () => this.onHover(null) },
      make("th", { scope: "row" }, button),
      make("td", { className: "number" }, hole.probability == null ? "–" : shortPercent(hole.probability)),
      make("td", { className: "number" }, told(hole.area, hole.area_error)),
      make("td", { className: "number" }, told(hole.perimeter, hole.perimeter_error)));
  }

  mark(chosen, kept) {
    for (const { element, chosen: own } of this.rows) {
      element.classList.toggle("chosen", isSame(own, chosen));
      element.querySelector("button").setAttribute("aria-pressed", String(isSame(own, kept)));
    }
  }
}

/** A hole with its size in metres of the operator's frame, where there is one; without a size where its component is not in it. */
function inFrame(map, hole, index) {
  if (!map.frame) return hole;
  const { area = null, area_error = null, perimeter = null, perimeter_error = null } = map.frame.holes.find(({ number }) => number === index + 1) ?? {};
  return { ...hole, area, area_error, perimeter, perimeter_error };
}

export function isSame(one, other) {
  return one?.hole === other?.hole && one?.possible === other?.possible && Boolean(one) === Boolean(other);
}

function round(value) {
  return Number(value.toPrecision(2));
}
