// The card beside the map: diagram or barcode with the list of holes, places and ways, or what can be saved.

import { make } from "./dom.js";

const VIEWS = [["as-diagram", "Diagram"], ["as-barcode", "Barcode"], ["as-places", "Places"], ["as-exports", "Save"]];
const TITLES = { "as-diagram": "Holes", "as-barcode": "Holes", "as-places": "Places and ways", "as-exports": "Save" };

/** Build it; `onView(id)` says which view was chosen. Returns its elements, and `choose(id)`. */
export function buildShapeCard(root, { onView }) {
  const title = make("h2", { id: "shape-title" }, "Holes");
  const diagram = make("div", { id: "diagram", className: "plot" }, make("p", { className: "empty" }, "Loops and how long they last, as soon as there is a map."));
  const holes = make("div", { id: "holes-list", className: "holes-list" });
  const loops = make("div", { className: "loops" }, diagram, holes);
  const places = make("div", { id: "places", className: "panel-body", hidden: true });
  const exports = make("div", { id: "exports", className: "panel-body", hidden: true });
  const choose = (id) => {
    buttons.forEach((button) => button.setAttribute("aria-pressed", String(button.id === id)));
    title.textContent = TITLES[id];
    loops.hidden = id === "as-places" || id === "as-exports";
    places.hidden = id !== "as-places";
    exports.hidden = id !== "as-exports";
    onView(id);
  };
  const buttons = VIEWS.map(([id, text], index) => make("button", { id, type: "button", "aria-pressed": String(index === 0), onclick: () => choose(id) }, text));
  root.replaceChildren(make("div", { className: "card-head" }, title, make("div", { className: "tools", role: "group", "aria-label": "What is shown" }, ...buttons)), loops, places, exports);
  root.setAttribute("aria-labelledby", "shape-title");
  return { diagram, holes, places, exports, choose };
}
