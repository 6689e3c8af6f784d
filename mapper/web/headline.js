// What the map says, in figures that can be read from afar: components, holes and how sure they are, and what it is of.

import { make, setText } from "./dom.js";
import { clock, count, length, percent } from "./format.js";
import { unitOf } from "./map_scene.js";

const FIGURES = [["components", true], ["holes", true], ["encounters", false], ["diameter", false]];
const WORDS = { components: "components", holes: "holes", encounters: "encounters", diameter: "across" };

export class Headline {
  constructor(root) {
    this.values = {};
    this.words = {};
    const list = make("dl", { className: "figures" });
    for (const [name, isMain] of FIGURES) {
      this.words[name] = make("dt", { id: `${name}-word` }, WORDS[name]);
      this.values[name] = make("dd", { id: name }, "–");
      list.append(make("div", { className: isMain ? "figure main" : "figure" }, this.words[name], this.values[name]));
    }
    this.limits = make("p");
    this.notes = make("summary");
    this.warnings = make("ul");
    this.doubts = make("details", {}, this.notes, this.warnings);
    this.notices = make("div", { id: "notices", className: "notices", hidden: true }, this.limits, this.doubts);
    root.replaceChildren(list, this.notices);
  }

  show(map) {
    const isEnough = map.data?.is_enough !== false;
    ["component", "hole"].forEach((word, dimension) => {
      const number = map.betti_numbers[dimension];
      const isDoubtful = word === "hole" && !isEnough;
      setText(this.values[`${word}s`], isDoubtful ? "?" : count(number));
      const sure = word === "hole" && map.hole_count ? ` (${sureText(map.hole_count, isDoubtful)})` : "";
      setText(this.words[`${word}s`], (number === 1 && !isDoubtful ? word : `${word}s`) + sure);
    });
    setText(this.values.encounters, count(map.n_encounters));
    const cause = map.window_s === null ? "from before the landmarks stood" : "from before the landmarks stood or the window began";
    this.values.encounters.title = `up to ${clock(map.last_encounter_s)}` + (map.n_before ? `; ${count(map.n_before)} more, ${cause}, are left out` : "");
    const error = Math.max(...map.components.map((part) => part.scale?.error ?? 0));
    const { factor, unit } = unitOf(map, map.components.findIndex((part) => part.diameter === map.diameter));
    setText(this.values.diameter, length(map.diameter * factor, unit) + (error && !map.frame ? ` ± ${Math.round(100 * error)} %` : ""));
    this.showNotices(limits(map), map.warnings);
  }

  /** What limits the map is said outright; what its maker says of how it was made is there for who asks. */
  showNotices(told, warnings) {
    this.notices.hidden = told.length + warnings.length === 0;
    this.limits.hidden = told.length === 0;
    setText(this.limits, told.join(" · "));
    this.doubts.hidden = warnings.length === 0;
    setText(this.notes, warnings.length === 1 ? "1 note on how this map was made" : `${count(warnings.length)} notes on how this map was made`);
    if (warnings.join() === this.shown) return;
    this.shown = warnings.join();
    this.warnings.replaceChildren(...warnings.map((text) => make("li", {}, text)));
  }

  /** Before the first map: how many encounters there are. */
  showWaiting(nEncounters) {
    setText(this.values.encounters, count(nEncounters));
  }
}

function sureText(told, isDoubtful) {
  if (told.is_known === false) return "not known";
  return isDoubtful ? `${count(told.value)} with ${percent(told.probability)}` : `${percent(told.probability)} sure`;
}

function limits(map) {
  const window = map.window_s === null ? [] : [`a map of the last ${count(map.window_s)} s`];
  return map.parameters.method === "default" ? window : [...window, `by the method "${map.parameters.method}"`];
}
