// The card of the map: its canvas with tools, what stands in place of a map, legend and layers, scale, and time.

import { make } from "./dom.js";
import { draw } from "./svg.js";

const LAYERS = [
  ["complex", "ground", "Where places are joined that are no further apart than the scale (the Rips complex)", () => [draw("path", { d: "M1 13 8 2l7 11z", class: "key-complex" })]],
  ["points", "encounters", "Places where biobots met; early ones in the first colour, late ones in the second", () => [draw("circle", { cx: 4, cy: 8, r: 3.6, class: "key-early" }), draw("circle", { cx: 12, cy: 8, r: 3.6, class: "key-late" })]],
  ["holes", "holes", "Full line: 90 % sure and more; broken: less; dotted and faint: only possible", () => [draw("path", { d: "M3 10 5 3l7 1 2 7-6 3z", class: "key-hole" })]],
  ["landmarks", "landmarks", "Biobots that stand still", () => [draw("rect", { x: 3, y: 3, width: 10, height: 10, class: "key-landmark" })]],
  ["uncertain", "doubtful", "Hollow and hatched: places whose distances may be wrong by more than a tenth of the map", () => [draw("path", { d: "M1 11 11 1M5 15 15 5", class: "key-doubt" }), draw("circle", { cx: 8, cy: 8, r: 3.4, class: "key-hollow" })]],
];

/** Build it; returns its elements by what they are. */
export function buildMapCard(root, { onLayer, onZoom, onFit }) {
  const tool = (id, text, label, click) => make("button", { id, type: "button", "aria-label": label, title: label, onclick: click }, text);
  const canvas = make("canvas", { id: "map-canvas", tabIndex: 0, role: "img", "aria-label": "No map yet" });
  const tip = make("p", { id: "map-tip", className: "tip", hidden: true });
  const antennae = make("div", { className: "antennae", "aria-hidden": "true" }, make("i"), make("i"), make("i"));
  const waitingText = make("p", { id: "waiting-text" }, "The map begins when biobots have met.");
  const waitingTime = make("p", { id: "waiting-time" });
  const waitingTitle = make("strong", { id: "waiting-title" }, "Waiting for encounters");
  const waiting = make("div", { id: "waiting", className: "waiting", role: "status" }, antennae, make("p", {}, waitingTitle), waitingText, waitingTime);
  const stage = make("div", { className: "stage" }, canvas, tip, waiting);
  const verdict = make("div", { id: "verdict", className: "verdict", role: "status", hidden: true });
  const time = make("div", { id: "timeline", className: "timeline" });
  const scale = make("div", { className: "scale-tools" });
  const hint = make("p", { className: "hint", id: "orientation" });
  const layers = LAYERS.map(([name, text, title, symbol]) => {
    const box = make("input", { type: "checkbox", "data-layer": name, checked: true, onchange: () => onLayer(name, box.checked) });
    return make("label", { title }, box, draw("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, ...symbol()), text);
  });
  root.replaceChildren(
    make("div", { className: "card-head" }, make("h2", { id: "map-title" }, "Map"), hint,
      make("div", { className: "tools", role: "group", "aria-label": "View" },
        tool("zoom-out", "−", "Zoom out", () => onZoom(1 / 1.3)), tool("zoom-in", "+", "Zoom in", () => onZoom(1.3)), make("button", { id: "zoom-fit", type: "button", onclick: onFit }, "Fit"))),
    verdict, stage, time,
    make("div", { className: "legend" }, make("div", { className: "layers", role: "group", "aria-label": "Layers" }, ...layers), scale));
  root.setAttribute("aria-labelledby", "map-title");
  return { canvas, tip, stage, waiting, waitingTitle, waitingText, waitingTime, verdict, time, scale, hint };
}
