// At which scale the complex is drawn: the map's own, or one that the operator chooses. All lengths are fetched when it is first touched.

import { make, setText } from "./dom.js";
import { length } from "./format.js";

const STEPS = 120;
/** Beyond the last loop by so much there is nothing more to see. */
const BEYOND = 1.15;

export class ScaleSlider {
  /** `onScale(share of the diameter | null)`: null is the map's own; returns a promise. */
  constructor(root, { onScale }) {
    this.onScale = onScale;
    this.map = null;
    this.share = null;
    this.range = make("input", { id: "scale", type: "range", min: "0", max: String(STEPS), value: "0", "aria-label": "Scale at which places are joined" });
    this.value = make("output", { id: "epsilon", htmlFor: "scale" });
    this.own = make("button", { id: "scale-own", type: "button", title: "The scale that shows this map's holes best", "aria-pressed": "true", onclick: () => this.choose(null) }, "auto");
    this.range.addEventListener("input", () => this.choose((Number(this.range.value) / STEPS) * this.limit()));
    root.replaceChildren(make("label", { htmlFor: "scale" }, "scale"), this.range, this.value, this.own);
    root.hidden = true;
    this.root = root;
  }

  /** `canChoose` false: the lengths of this map are not kept. */
  show(map, { canChoose }) {
    this.map = map;
    this.root.hidden = false;
    this.range.disabled = !canChoose;
    this.range.title = canChoose ? "Places no further apart than this are joined" : "Only the newest map can be drawn at another scale";
    this.render();
  }

  limit() {
    const deaths = [...this.map.intervals["1"].map(([, death]) => death ?? 0), ...this.map.components.map((part) => part.epsilon)];
    return Math.min(1, (BEYOND * Math.max(...deaths)) / (this.map.diameter || 1));
  }

  /** At which length the complex is drawn; null: each component has its own. */
  drawn(isOwn = this.share === null) {
    if (!isOwn) return this.share * this.map.diameter;
    const own = [...new Set(this.map.components.map((part) => part.epsilon))];
    return own.length === 1 ? own[0] : null;
  }

  choose(share) {
    this.share = share;
    this.render();
    return this.onScale(share);
  }

  render() {
    const unit = this.map.parameters.length_unit, drawn = this.drawn();
    const scales = [...new Set(this.map.components.map((part) => length(part.epsilon, unit)))];
    setText(this.value, drawn === null ? scales.slice(0, 2).join(", ") : length(drawn, unit));
    this.range.value = String(Math.round((((drawn ?? this.map.components[0].epsilon) / (this.map.diameter || 1)) / this.limit()) * STEPS));
    this.range.setAttribute("aria-valuetext", this.value.textContent);
    this.own.setAttribute("aria-pressed", String(this.share === null));
  }
}
