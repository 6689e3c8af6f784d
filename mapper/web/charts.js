// What the map says, as the operator sees it: headline, map, diagram, past, places, exports. Fetches what changed, and shows it everywhere.

import { say, tell } from "./announce.js";
import { setText } from "./dom.js";
import { DiagramView } from "./diagram_view.js";
import { ExportsPanel } from "./exports_panel.js";
import { count } from "./format.js";
import { Headline } from "./headline.js";
import { HoleList, isSame } from "./hole_list.js";
import { findAgain } from "./hole_match.js";
import { buildMapCard } from "./map_card.js";
import { unitOf } from "./map_scene.js";
import { MapView } from "./map_view.js";
import { PastMaps } from "./past_maps.js";
import { PlacesPanel } from "./places_panel.js";
import { ScaleSlider } from "./scale_slider.js";
import { buildShapeCard } from "./shape_card.js";
import { readLengths } from "./simplices.js";
import { SpotPanel } from "./spot_panel.js";
import { TimeSlider } from "./time_slider.js";
import { Verdict, sentence, waitText } from "./verdict.js";

const CONFLICT = 409;

/** Fill the three elements and keep them up to date; `live`, `net` and `account` are the page's. */
export function createCharts({ headline, map, shape, live, net, account }) {
  return new Charts({ headline, map, shape, live, net, account });
}

class Charts {
  constructor({ headline, map, shape, live, net, account }) {
    Object.assign(this, { live, net });
    this.newest = { map: null, diagram: null };
    this.shown = { map: null, diagram: null, isLive: true };
    this.hovered = this.kept = null;
    this.lengths = null;
    this.routeEnds = null;
    this.fetchMap = net.makeFetcher("/api/v1/map");
    this.fetchDiagram = net.makeFetcher("/api/v1/diagram");
    this.past = new PastMaps(net);
    this.build({ headline, map, shape, account });
    live.follow(["map"], () => this.refreshMap());
    live.follow(["records"], async () => {
      if (this.newest.map === null) await this.hasMap();
    });
    live.follow(["maps"], async () => this.time.show(await this.past.list()));
    live.follow(["map", "pins"], () => this.refreshPins());
    document.addEventListener("charts:show-version", (event) => this.time.pick(event.detail.version));
    document.addEventListener("charts:show-place", (event) => this.look(event.detail.place));
  }

  build({ headline, map, shape, account }) {
    this.headline = new Headline(headline);
    const card = (this.card = buildMapCard(map, {
      onLayer: (name, isShown) => this.view.setLayer(name, isShown), onZoom: (factor) => this.view.zoom(factor), onFit: () => this.view.fit(),
    }));
    const side = (this.side = buildShapeCard(shape, { onView: (id) => this.showView(id) }));
    const choices = { onHover: (chosen) => this.hover(chosen), onKeep: (chosen) => this.keep(chosen) };
    this.view = new MapView(card.canvas, card.tip, { ...choices, onSpot: (place, at) => this.takeSpot(place, at) });
    this.verdict = new Verdict(card.verdict);
    this.scale = new ScaleSlider(card.scale, { onScale: () => this.showComplex() });
    this.time = new TimeSlider(card.time, { live: this.live, onPick: (version) => this.showVersion(version) });
    this.spot = new SpotPanel(card.stage, card.canvas, {
      onName: () => this.usePlace((panel) => panel.name.focus()), onFrom: () => this.usePlace((panel) => panel.startFrom(false)),
      onTo: () => this.usePlace((panel) => panel.startFrom(true)), onClose: () => this.dropSpot(),
    });
    this.diagram = new DiagramView(side.diagram, choices);
    this.holes = new HoleList(side.holes, choices);
    this.places = new PlacesPanel(side.places, {
      onPut: (pin) => this.putPin(pin), onRemove: (name) => this.removePin(name), onRoute: (from, to) => this.findRoutes(from, to),
      onClearRoute: () => this.clearRoutes(), onLook: (pin) => pin.spot && this.view.centre(pin.spot), account,
    });
    new ExportsPanel(side.exports, { save: (path, name) => this.net.save(path, name) });
  }

  async refreshMap() {
    if (this.newest.map === null && !(await this.hasMap())) return;
    const [map, diagram] = await Promise.all([this.fetchMap(), this.fetchDiagram()]);
    this.newest = { map: map ?? this.newest.map, diagram: diagram ?? this.newest.diagram };
    if (this.time.version !== null) return;
    await this.show({ ...this.newest, isLive: true });
    if (this.newest.map.data?.is_enough === false) await this.expect();
    if (this.routeEnds) await this.findRoutes(...this.routeEnds).catch(() => this.places.clearRoutes());
  }

  /** Whether there is a map; before that, say what it waits for, and how long that is likely to take. */
  async hasMap() {
    const status = await this.net.getJson("/api/v1/map/status");
    if (status.version !== null) return true;
    this.headline.showWaiting(status.n_known);
    setText(this.card.waitingTitle, status.n_known ? "Not enough data yet" : "Waiting for encounters");
    setText(this.card.waitingText, status.waiting ?? "The map begins when biobots have met.");
    // What has come is looked at while a map is made of it, or is found to be too little for one.
    if (status.n_known > 0 && !status.is_computing) await this.expect();
    return false;
  }

  /** How long it is likely to take until the data are enough. */
  async expect() {
    const coverage = await this.net.getJson("/api/v1/coverage");
    const waitS = coverage.data?.expected_wait_s ?? null;
    const standstill = coverage.data?.nothing_arrives ?? null;
    this.verdict.expect(waitS, standstill);
    setText(this.card.waitingTime, waitS ? `At this rate, a statement is likely in ${waitText(waitS)}.` : sentence(standstill));
  }

  /** Ask that again now and then: no event tells that nothing arrives any more. */
  async expectAgain() {
    if (this.newest.map === null) await this.hasMap();
    else if (this.time.version === null && this.newest.map.data?.is_enough === false) await this.expect();
  }

  async show(shown) {
    const before = this.shown;
    this.shown = shown;
    const { map, isLive } = shown;
    this.card.waiting.hidden = true;
    // What is looked at stays marked while the map grows; who slides through the past begins anew.
    if (before.map && before.map.version !== map.version) {
      [this.hovered, this.kept] = [this.hovered, this.kept].map((chosen) => (isLive && before.isLive ? findAgain(chosen, before.map, map) : null));
    }
    if (!isLive) {
      this.scale.share = null;
      this.verdict.expect(null);
    }
    this.scale.show(map, { canChoose: isLive });
    this.view.show(map);
    await this.showComplex();
    this.verdict.show(map.data);
    this.headline.show(map);
    this.holes.show(map);
    this.mark();
    this.places.showMap(this.newest.map);
    this.markPlaces();
    setText(this.card.hint, map.frame ? "in your frame: x right, y up" : "may be turned or mirrored");
    const was = before.map?.betti_numbers[1], now = map.betti_numbers[1];
    if (isLive && before.isLive && was !== undefined && was !== now) say(`The map now shows ${now === 1 ? "1 hole" : `${count(now)} holes`}.`);
    document.dispatchEvent(new CustomEvent("charts:map", { detail: { map, isLive } }));
  }

  /** Draw the complex at the scale that is chosen; lengths are fetched only where that is not the map's own. */
  async showComplex() {
    const { map, diagram, isLive } = this.shown;
    const share = isLive ? this.scale.share : null;
    const lengths = share === null ? null : await this.fetchLengths();
    // Meanwhile another map may have come, or another scale.
    if (this.shown.map !== map || (isLive ? this.scale.share : null) !== share) return;
    if (lengths !== null) this.view.setComplex(lengths, share);
    else if (this.isOtherScale) this.view.setComplex(null, null);
    this.isOtherScale = lengths !== null;
    this.diagram.show(diagram, map, this.scale.drawn(lengths === null));
  }

  /** The lengths of the newest map; null, and the scale is the map's own again, where they are not to be had. */
  async fetchLengths() {
    const { map } = this.newest;
    if (this.lengths?.map === map) return this.lengths.parts;
    try {
      const buffer = await (await this.net.getBlob(`/api/v1/map/lengths?version=${map.version}`)).arrayBuffer();
      const parts = readLengths(buffer, map.points.map((point) => point.component));
      if (this.newest.map === map) this.lengths = { map, parts };
      return parts;
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      // Another map is there already, and will be shown.
      if (problem.status === CONFLICT) return null;
      tell(problem.text, false);
      this.scale.choose(null);
      return null;
    }
  }

  /** null: the newest again. Who slides on while one is fetched sees the last one that was asked for. */
  showVersion(version) {
    this.wanted = version;
    this.sliding ??= this.slide().finally(() => (this.sliding = null));
    return this.sliding;
  }

  async slide() {
    for (let version; version !== this.wanted;) {
      version = this.wanted;
      try {
        if (version === null) await this.show({ ...this.newest, isLive: true });
        else await this.showPast(version);
      } catch (problem) {
        if (problem.status === undefined) throw problem;
        tell(problem.text, false);
      }
    }
  }

  async showPast(version) {
    const [map, diagram, change] = await Promise.all([this.past.map(version), this.past.diagram(version), this.past.changeBetween(version, this.newest.map.version)]);
    await this.show({ map, diagram, isLive: false });
    this.time.tellChange(change);
  }

  showView(id) {
    this.diagram.setBarcode(id === "as-barcode");
  }

  hover(chosen) {
    this.hovered = chosen;
    this.mark();
  }

  /** Keep a hole marked and bring it into sight, until it is pressed again. */
  keep(chosen) {
    this.kept = isSame(this.kept, chosen) ? null : chosen;
    if (this.kept) this.view.reveal(this.kept);
    this.mark();
  }

  mark() {
    const chosen = this.hovered ?? this.kept;
    this.view.choose(chosen);
    this.diagram.mark(chosen, this.kept);
    this.holes.mark(chosen, this.kept);
    document.dispatchEvent(new CustomEvent("charts:hole", { detail: { hole: chosen?.hole ?? null } }));
  }

  async refreshPins() {
    const { pins, frame, problems } = await this.net.getJson("/api/v1/pins");
    this.pins = pins;
    this.places.showPins(pins, { isFramed: frame !== null, problems });
    this.markPlaces();
  }

  /** Pins and ways are of the newest map; one of the past does not show them. */
  markPlaces() {
    if (!this.view.scene) return;
    const { scene } = this.view;
    for (const pin of this.pins ?? []) pin.spot = pin.map_x === null ? null : scene.toPicture([pin.map_x, pin.map_y], pin.component);
    const isLive = this.shown.isLive;
    this.view.mark({ pins: isLive ? (this.pins ?? []).filter((pin) => pin.spot).map((pin) => ({ name: pin.name, place: pin.spot })) : [], routes: isLive ? this.routes ?? [] : [] });
  }

  takeSpot(place, at) {
    if (!this.shown.isLive) return;
    const { x, y, component } = this.view.scene.toMap(place);
    const number = (value) => Number(value.toPrecision(6));
    this.places.takeSpot({ place: `xy:${number(x)},${number(y)},${component}`, words: "place on the map" });
    this.view.mark({ spot: place });
    this.spot.show(at);
  }

  usePlace(use) {
    this.side.choose("as-places");
    use(this.places);
    this.side.places.scrollIntoView?.({ block: "nearest" });
  }

  dropSpot() {
    this.places.takeSpot(null);
    this.view.mark({ spot: null });
  }

  async putPin({ name, ...pin }) {
    await this.net.send("PUT", `/api/v1/pins/${encodeURIComponent(name)}`, pin);
    this.view.mark({ spot: null });
    await this.refreshPins();
  }

  async removePin(name) {
    await this.net.send("DELETE", `/api/v1/pins/${encodeURIComponent(name)}`);
    await this.refreshPins();
  }

  async findRoutes(from, to) {
    const found = await this.net.getJson(`/api/v1/route?${new URLSearchParams({ from, to })}`);
    this.routeEnds = [from, to];
    this.routes = found.routes.map((route) => ({ xy: route.xy, component: found.from.component }));
    this.view.mark({ spot: null });
    this.markPlaces();
    const { factor, unit } = unitOf(this.newest.map, found.from.component);
    return { length_unit: unit, routes: found.routes.map((route) => ({ ...route, length: route.length * factor, length_error: route.length_error * factor })) };
  }

  clearRoutes() {
    this.routeEnds = null;
    this.routes = [];
    this.markPlaces();
  }

  /** Bring a place that others name ("landmark:7", "biobot:9") into sight; a way can begin or end there. */
  async look(place) {
    if (!this.shown.isLive) await this.time.returnToLive();
    const landmark = this.view.scene?.landmarks.find((one) => place === `landmark:${one.id}`);
    const spot = landmark?.place ?? (await this.findPlace(place));
    if (!spot) return;
    this.view.centre(spot);
    this.view.mark({ spot });
    this.places.takeSpot({ place, words: place.replace(":", " ") });
  }

  /** Where the mapper takes a place to be, in the picture; null, with the reason told, where it is on no map. */
  async findPlace(place) {
    try {
      const { from } = await this.net.getJson(`/api/v1/distance?${new URLSearchParams({ from: place, to: place })}`);
      return this.view.scene?.toPicture([from.x, from.y], from.component) ?? null;
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      tell(problem.text, false);
      return null;
    }
  }
}
