// Places that the operator names, and the ways between them. A place is a landmark, a place with a name, or what was tapped on the map.

import { make, setText } from "./dom.js";
import { length } from "./format.js";
import { ROUTE_NAMES } from "./map_marks.js";

const SPOT = "spot";
/** So many known places tell scale, direction and handedness. */
const PINS_OF_A_FRAME = 3;
const LEAST_TURN = 0.05;

export class PlacesPanel {
  /**
   * `onPut(pin)`, `onRemove(name)` and `onRoute(from, to)` return promises that fail with a problem that has `text`; `onClearRoute()`;
   * `account` keeps those who may only look from changing places.
   */
  constructor(root, { onPut, onRemove, onRoute, onClearRoute, onLook, account }) {
    Object.assign(this, { root, onPut, onRemove, onRoute, onClearRoute, onLook, account });
    this.pins = [];
    this.landmarks = [];
    this.spot = null;
    this.list = make("ul", { className: "pins", "aria-label": "Named places" });
    this.frame = make("p", { className: "note", id: "pins-frame" });
    this.name = make("input", { id: "pin-name", required: true, maxLength: 64, autocomplete: "off", placeholder: "door" });
    this.place = make("select", { id: "pin-place", required: true });
    this.x = make("input", { id: "pin-x", type: "number", step: "any", autocomplete: "off" });
    this.y = make("input", { id: "pin-y", type: "number", step: "any", autocomplete: "off" });
    this.pinButton = make("button", { type: "submit", className: "main" }, "Name it");
    this.from = make("select", { id: "route-from" });
    this.to = make("select", { id: "route-to" });
    this.routes = make("ol", { className: "routes", id: "routes", "aria-label": "Ways" });
    this.outcome = make("p", { className: "outcome", role: "status", id: "places-outcome" });
    account.guard(this.pinButton, "operator");
    root.replaceChildren(
      make("form", { className: "place-form", "aria-label": "Name a place", onsubmit: (event) => this.put(event) },
        field("Name", this.name), field("Place", this.place), field("x [m]", this.x, "narrow"), field("y [m]", this.y, "narrow"), this.pinButton),
      this.list, this.frame,
      make("form", { className: "place-form", "aria-label": "Ways between places", onsubmit: (event) => this.findRoutes(event) },
        field("From", this.from), field("To", this.to), make("button", { type: "submit", className: "main" }, "Show ways"),
        make("button", { type: "button", id: "route-clear", onclick: () => this.clearRoutes() }, "Clear")),
      this.routes, this.outcome);
    this.renderPlaces();
    this.renderPins();
  }

  showMap(map) {
    const names = [...new Set(map.landmarks.map((one) => String(one.id)))].sort((one, other) => one.localeCompare(other, "en", { numeric: true }));
    if (names.join() === this.landmarks.join()) return;
    this.landmarks = names;
    this.renderPlaces();
  }

  /** `pins`: [{name, place, x, y, problem, residual_m}]; `isFramed`: they fix the frame; `problems`: what stands in the way of that. */
  showPins(pins, { isFramed, problems }) {
    Object.assign(this, { pins, isFramed, problems });
    this.renderPlaces();
    this.renderPins();
  }

  /** What was tapped: {place: "xy:…", words}, or null. It can then be named, or be an end of a way. */
  takeSpot(spot) {
    this.spot = spot;
    this.renderPlaces();
    if (spot) this.place.value = SPOT;
  }

  startFrom(isEnd) {
    (isEnd ? this.to : this.from).value = SPOT;
  }

  renderPlaces() {
    const spot = this.spot ? [[SPOT, this.spot.words]] : [];
    const pins = this.pins.map((pin) => [`pin:${pin.name}`, pin.name]);
    const landmarks = this.landmarks.map((name) => [`landmark:${name}`, `landmark ${name}`]);
    fillSelect(this.place, [...spot, ...landmarks]);
    for (const select of [this.from, this.to]) fillSelect(select, [...spot, ...pins, ...landmarks]);
    if (!this.hasChosen && this.to.options.length > 1) {
      this.to.selectedIndex = this.to.options.length - 1;
      this.hasChosen = true;
    }
  }

  renderPins() {
    this.list.querySelectorAll(".remove").forEach((button) => this.account.forget(button));
    this.list.replaceChildren(...this.pins.map((pin) => {
      const remove = make("button", { type: "button", className: "remove", "aria-label": `Remove ${pin.name}`, onclick: () => this.remove(pin.name) }, "Remove");
      this.account.guard(remove, "operator");
      const known = pin.x === null ? "no known place" : `x ${pin.x} m, y ${pin.y} m`;
      const told = pin.problem ?? (pin.residual_m === null ? known : `${known}, off by ${length(pin.residual_m, "m")}`);
      return make("li", {}, make("button", { type: "button", className: "plain pin-name", title: "Bring it into sight", onclick: () => this.onLook(pin) }, pin.name),
        make("span", { className: pin.problem ? "soft bad" : "soft" }, told), remove);
    }));
    const known = this.pins.filter((pin) => pin.x !== null).length;
    const lacking = known >= PINS_OF_A_FRAME ? (this.problems ?? []).join("; ") || "The frame is being made." : `${known} of ${PINS_OF_A_FRAME} known places (x and y): with ${PINS_OF_A_FRAME} the map is no longer turned or mirrored, and in metres.`;
    setText(this.frame, this.isFramed ? "The map lies in your frame: metres, x to the right, y up." : lacking);
  }

  /** The form in which the service knows a chosen place. */
  formOf(value) {
    if (value === SPOT) return this.spot?.place ?? null;
    return value.startsWith("pin:") ? this.pins.find((pin) => pin.name === value.slice(4))?.place ?? null : value;
  }

  async put(event) {
    event.preventDefault();
    const name = this.name.value.trim();
    const [x, y] = [this.x, this.y].map((input) => (input.value === "" ? null : Number(input.value)));
    if (!name) return this.tell("Give the place a name first.", false);
    if ((x === null) !== (y === null)) return this.tell("Give both x and y, or neither.", false);
    const place = this.formOf(this.place.value);
    if (!place) return this.tell("Choose a landmark, or tap the map, first.", false);
    const sent = [this.name, this.x, this.y].map((input) => [input, input.value]);
    await this.attempt(async () => {
      await this.onPut({ name, place, x, y });
      // Who is quick has begun to write the next one meanwhile: that stays.
      sent.filter(([input, value]) => input.value === value).forEach(([input]) => (input.value = ""));
      this.takeSpot(null);
      return `${name} is on the map.`;
    });
  }

  async remove(name) {
    await this.attempt(async () => {
      await this.onRemove(name);
      this.name.focus();
      return `${name} is removed.`;
    });
  }

  async findRoutes(event) {
    event.preventDefault();
    const [from, to] = [this.from, this.to].map((select) => this.formOf(select.value));
    if (!from || !to) return this.tell("Choose both ends first: a named place, a landmark, or a tap on the map.", false);
    const names = [this.from, this.to].map((select) => select.selectedOptions[0].textContent);
    await this.attempt(async () => {
      const found = await this.onRoute(from, to);
      this.showRoutes(found, names);
      return "";
    });
  }

  showRoutes(found, [from, to]) {
    this.routes.replaceChildren(...found.routes.map((route, index) => make("li", {},
      make("strong", {}, ROUTE_NAMES[index]), ` ${length(route.length, found.length_unit)} ± ${length(route.length_error, found.length_unit)}${sides(route)}`)));
    setText(this.outcome, "");
    this.routes.setAttribute("aria-label", `Ways from ${from} to ${to}`);
  }

  clearRoutes() {
    this.routes.replaceChildren();
    this.tell("", null);
    this.onClearRoute();
  }

  async attempt(task) {
    try {
      this.tell(await task(), true);
    } catch (problem) {
      if (problem.text === undefined) throw problem;
      this.tell(problem.text, false);
    }
  }

  tell(text, isFine) {
    setText(this.outcome, text);
    this.outcome.className = `outcome ${isFine === null ? "" : isFine ? "good" : "bad"}`;
  }
}

/** On which side each obstacle is of one who walks: what one turns about counter-clockwise is on the left. */
function sides(route) {
  const told = route.passes.filter(({ turns }) => Math.abs(turns) >= LEAST_TURN).map(({ hole, turns }) => `hole ${hole} on the ${turns > 0 ? "left" : "right"}`);
  return told.length ? `, ${told.join(", ")}` : "";
}

function field(label, input, kind = "") {
  return make("label", { className: `field ${kind}` }, make("span", {}, label), input);
}

function fillSelect(select, options) {
  const before = select.value;
  select.replaceChildren(...(options.length ? options : [["", "none yet"]]).map(([value, text]) => make("option", { value }, text)));
  if (options.some(([value]) => value === before)) select.value = before;
}
