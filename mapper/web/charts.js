// The map, its figures and its persistence diagram: makes their elements and keeps them up to date.

import { DiagramView } from "./diagram_view.js";
import { clock, count, length, percent } from "./format.js";
import { MapView } from "./map_view.js";

const HEADLINE = `
  <dl>
    <div class="figure main"><dt id="components-word">components</dt><dd id="components">–</dd></div>
    <div class="figure main"><dt id="holes-word">holes</dt><dd id="holes">–</dd></div>
    <div class="figure"><dt>encounters</dt><dd id="encounters">–</dd></div>
    <div class="figure"><dt>across</dt><dd id="diameter">–</dd></div>
  </dl>
  <p id="notices" role="status"></p>`;
const MAP = `
  <div class="card-head">
    <h2 id="map-title">Map</h2>
    <div class="tools" role="group" aria-label="Layers">
      <label><input type="checkbox" data-layer="complex" checked> complex</label>
      <label><input type="checkbox" data-layer="points" checked> points</label>
      <label><input type="checkbox" data-layer="holes" checked> holes</label>
      <label><input type="checkbox" data-layer="landmarks" checked> landmarks</label>
    </div>
    <div class="tools" role="group" aria-label="View">
      <button type="button" id="zoom-out" aria-label="Zoom out">−</button>
      <button type="button" id="zoom-in" aria-label="Zoom in">+</button>
      <button type="button" id="zoom-fit">Fit</button>
      <button type="button" id="save" hidden>SVG</button>
    </div>
  </div>
  <div class="stage">
    <canvas id="map-canvas" tabindex="0" role="img" aria-label="No map yet"></canvas>
    <p id="map-tip" class="tip" hidden></p>
    <div id="waiting" class="waiting">
      <div class="antennae" aria-hidden="true"><i></i><i></i><i></i></div>
      <p><strong id="waiting-title">Waiting for encounters</strong></p>
      <p id="waiting-text">The map begins when biobots have met.</p>
    </div>
  </div>
  <ul class="legend" aria-label="Legend">
    <li><svg viewBox="0 0 16 16" aria-hidden="true"><circle cx="8" cy="8" r="4" class="key-early"/></svg>early encounter</li>
    <li><svg viewBox="0 0 16 16" aria-hidden="true"><circle cx="8" cy="8" r="4" class="key-late"/></svg>late</li>
    <li><svg viewBox="0 0 16 16" aria-hidden="true"><path d="M2 13 8 3l6 10z" class="key-complex"/></svg>joined within ε <span id="epsilon"></span></li>
    <li><svg viewBox="0 0 16 16" aria-hidden="true"><path d="M3 10 5 3l7 1 2 7-6 3z" class="key-hole"/></svg>hole</li>
    <li><svg viewBox="0 0 16 16" aria-hidden="true"><rect x="3" y="3" width="10" height="10" class="key-landmark"/></svg>landmark</li>
    <li class="hint">may be turned or mirrored</li>
  </ul>`;
const SHAPE = `
  <div class="card-head">
    <h2 id="shape-title">Persistence</h2>
    <div class="tools" role="group" aria-label="Kind of picture">
      <button type="button" id="as-diagram" aria-pressed="true">Diagram</button>
      <button type="button" id="as-barcode" aria-pressed="false">Barcode</button>
    </div>
  </div>
  <div id="diagram" class="plot"><p class="empty">Loops and how long they last, as soon as there is a map.</p></div>`;

const element = (id) => document.getElementById(id);

export function createCharts({ headline, map: mapCard, shape, live, net }) {
  headline.innerHTML = HEADLINE;
  mapCard.innerHTML = MAP;
  shape.innerHTML = SHAPE;
  const mapView = new MapView(element("map-canvas"), element("map-tip"));
  const diagramView = new DiagramView(element("diagram"), { onChoose: (hole) => mapView.choose(hole) });
  const fetchers = Object.fromEntries(Object.entries({ health: "/healthz", map: "/api/v1/map", diagram: "/api/v1/diagram" }).map(([name, path]) => [name, net.makeFetcher(path)]));
  let map = null;
  let diagram = null;

  live.follow(["map"], async () => {
    const health = await fetchers.health();
    showNotices(health);
    if (health.map_version === null) return showWaiting(health);
    const [newMap, newDiagram] = await Promise.all([fetchers.map(), fetchers.diagram()]);
    map = newMap ?? map;
    diagram = newDiagram ?? diagram;
    element("waiting").hidden = true;
    element("save").hidden = false;
    mapView.show(map);
    diagramView.show(diagram, map.holes);
    showNotices(health);
    ["component", "hole"].forEach((word, dimension) => {
      const number = map.betti_numbers[dimension];
      element(`${word}s`).textContent = count(number);
      const sure = word === "hole" && map.hole_count ? ` (${percent(map.hole_count.probability)} sure)` : "";
      element(`${word}s-word`).textContent = (number === 1 ? word : `${word}s`) + sure;
    });
    element("encounters").textContent = count(map.n_encounters);
    const cause = map.window_s === null ? "from before the landmarks stood" : "from before the landmarks stood or the window began";
    element("encounters").title = `up to ${clock(map.last_encounter_s)}` + (map.n_before ? `; ${count(map.n_before)} more, ${cause}, are left out` : "");
    element("diameter").textContent = length(map.diameter, map.parameters.length_unit);
    const scales = [...new Set(map.components.map((part) => length(part.epsilon, map.parameters.length_unit)))];
    element("epsilon").textContent = `= ${scales.slice(0, 2).join(", ")}`;
  });

  function showWaiting(health) {
    element("encounters").textContent = count(health.n_encounters);
    element("waiting").hidden = false;
    element("waiting-text").textContent = health.waiting ?? "The map begins when biobots have met.";
  }

  function showNotices(health) {
    // Before the first map, what it waits for stands in its place.
    const standstill = health.map_version !== null && health.waiting ? [health.waiting] : [];
    element("notices").textContent = [...standstill, ...limits(), ...lacks(), ...(map?.warnings ?? [])].join(" · ");
  }

  function limits() {
    if (!map) return [];
    const window = map.window_s === null ? [] : [`a map of the last ${count(map.window_s)} s`];
    return map.parameters.method === "default" ? window : [...window, `by the method "${map.parameters.method}"`];
  }

  function lacks() {
    if (!map?.data || map.data.is_enough) return [];
    return [`not enough data yet: ${map.data.reasons.join("; ")}`, `it would help to ${map.data.remedies.join("; ")}`];
  }

  for (const box of mapCard.querySelectorAll("[data-layer]")) box.addEventListener("change", () => mapView.setLayer(box.dataset.layer, box.checked));
  element("zoom-in").addEventListener("click", () => mapView.zoom(1.3));
  element("zoom-out").addEventListener("click", () => mapView.zoom(1 / 1.3));
  element("zoom-fit").addEventListener("click", () => mapView.fit());
  element("save").addEventListener("click", () => net.save("/api/v1/map.svg", "map.svg"));
  for (const [id, isBarcode] of [["as-diagram", false], ["as-barcode", true]]) {
    element(id).addEventListener("click", () => {
      element("as-diagram").setAttribute("aria-pressed", String(!isBarcode));
      element("as-barcode").setAttribute("aria-pressed", String(isBarcode));
      diagramView.setBarcode(isBarcode);
    });
  }
}
