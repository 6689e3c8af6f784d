// Wires the page: what changed is fetched again, and only that.

import { DiagramView } from "./diagram_view.js";
import { EmergencyStop } from "./emergency_stop.js";
import { age, clock, count, length, percent } from "./format.js";
import { MapView } from "./map_view.js";
import { makeFetcher, watch } from "./net.js";
import { Roster } from "./roster.js";

const MIN_PERIOD_MS = 400;
const PHASES = { idle: "no mission", dispersion: "dispersion", landmark_selection: "choosing landmarks", exploration: "exploration", paused: "mission paused", done: "mission done" };

const element = (id) => document.getElementById(id);
const mapView = new MapView(element("map-canvas"), element("map-tip"));
const diagramView = new DiagramView(element("diagram"), { onChoose: (hole) => mapView.choose(hole) });
const roster = new Roster({ body: element("rows"), empty: element("no-rows"), filter: element("filter"), outcome: element("outcome") });
new EmergencyStop({ button: element("emergency"), panel: element("stop-panel"), title: element("stop-title"), lines: element("stop-lines"), close: element("stop-close") });

const fetchers = Object.fromEntries(Object.entries({ health: "/healthz", map: "/api/v1/map", status: "/api/v1/map/status", diagram: "/api/v1/diagram", biobots: "/api/v1/biobots", mission: "/api/v1/mission" }).map(([name, path]) => [name, makeFetcher(path)]));
let map = null;
let diagram = null;
let mapBegunAt = null;
let waiting = 0;
let standstill = null;
let isLineUp = false;
let gateways = [];

/** Run a task soon, once for many calls, and never twice at a time. */
function paced(task) {
  let isWanted = false, isRunning = false;
  const run = async () => {
    isRunning = true;
    while (isWanted) {
      isWanted = false;
      // The event stream tells when the line is down; here the next change simply tries again.
      await task().catch((error) => console.warn(error.message));
      await new Promise((resolve) => setTimeout(resolve, MIN_PERIOD_MS));
    }
    isRunning = false;
  };
  return () => {
    isWanted = true;
    if (!isRunning) run();
  };
}

const refreshMap = paced(async () => {
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
  tick();
});

const refreshStatus = paced(async () => {
  const status = await fetchers.status();
  if (status.version === null) return;
  mapBegunAt = performance.now() - (status.now_wall_ns - status.begun_wall_ns) / 1e6;
  waiting = status.n_waiting;
  standstill = status.waiting;
  tick();
});

const refreshBiobots = paced(async () => {
  const answer = await fetchers.biobots();
  gateways = answer.gateways;
  roster.show(answer);
  const landmarks = answer.biobots.filter((biobot) => biobot.is_landmark).length;
  element("biobots").textContent = landmarks ? `${count(answer.biobots.length)} (${landmarks} landmarks)` : count(answer.biobots.length);
  showLink();
});

const refreshMission = paced(async () => {
  const { phase } = await fetchers.mission();
  element("mission").hidden = phase === null;
  if (phase) element("mission").textContent = PHASES[phase.phase] ?? phase.phase;
});

function showWaiting(health) {
  element("encounters").textContent = count(health.n_encounters);
  element("waiting").hidden = false;
  element("waiting-text").textContent = health.waiting ?? "The map begins when biobots have met.";
}

function limits() {
  if (!map) return [];
  const window = map.window_s === null ? [] : [`a map of the last ${count(map.window_s)} s`];
  return map.parameters.method === "default" ? window : [...window, `by the method "${map.parameters.method}"`];
}

function showNotices(health) {
  // Before the first map, what it waits for stands in its place.
  const standstill = health.map_version !== null && health.waiting ? [health.waiting] : [];
  element("notices").textContent = [...health.faults, ...standstill, ...limits(), ...lacks(), ...(map?.warnings ?? [])].join(" · ");
}

function lacks() {
  if (!map?.data || map.data.is_enough) return [];
  return [`not enough data yet: ${map.data.reasons.join("; ")}`, `it would help to ${map.data.remedies.join("; ")}`];
}

function showLink() {
  const alive = gateways.filter((gateway) => gateway.is_alive);
  const silent = alive.flatMap((gateway) => Object.entries(gateway.radios).filter(([, state]) => state !== "up").map(([radio, state]) => `${radio} ${state}`));
  const [state, words] = !isLineUp ? ["bad", "mapper does not answer, trying again"]
    : silent.length ? ["bad", `radio ${silent.join(", ")}`]
    : alive.length ? ["good", `live, ${alive.length === 1 ? `gateway ${alive[0].name}` : `${alive.length} gateways`}`]
      : gateways.length ? ["bad", `gateway ${gateways.map((gateway) => gateway.name).join(", ")} is away`] : ["wait", "no gateway yet"];
  element("link").title = words;
  element("link").className = `chip state-${state}`;
  if (element("link-text").textContent !== words) element("link-text").textContent = words;
}

function tick() {
  element("age").textContent = mapBegunAt === null ? "–" : age((performance.now() - mapBegunAt) / 1000) + (waiting ? ` +${count(waiting)}` : "");
  element("age").title = standstill ?? (waiting ? `${count(waiting)} records have come since and wait for the next map` : "of all records that have come");
  roster.tick();
}

for (const box of document.querySelectorAll("[data-layer]")) box.addEventListener("change", () => mapView.setLayer(box.dataset.layer, box.checked));
element("zoom-in").addEventListener("click", () => mapView.zoom(1.3));
element("zoom-out").addEventListener("click", () => mapView.zoom(1 / 1.3));
element("zoom-fit").addEventListener("click", () => mapView.fit());
for (const [id, isBarcode] of [["as-diagram", false], ["as-barcode", true]]) {
  element(id).addEventListener("click", () => {
    element("as-diagram").setAttribute("aria-pressed", String(!isBarcode));
    element("as-barcode").setAttribute("aria-pressed", String(isBarcode));
    diagramView.setBarcode(isBarcode);
  });
}

let seen = {};
watch({
  onState: (isUp) => {
    if (isUp && !isLineUp) seen = {};
    isLineUp = isUp;
    showLink();
  },
  onVersions: (versions) => {
    const hasNews = (...topics) => topics.some((topic) => versions[topic] !== seen[topic]);
    if (hasNews("map")) refreshMap();
    if (hasNews("map", "records")) refreshStatus();
    if (hasNews("map", "biobots", "commands")) refreshBiobots();
    if (hasNews("mission")) refreshMission();
    seen = versions;
  },
});
setInterval(tick, 1000);
// A gateway that falls silent causes no event.
setInterval(() => isLineUp && refreshBiobots(), 5000);
