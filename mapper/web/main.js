// Wires the page: what changed is asked for again, and only that.

import { Account } from "./account.js";
import { Alerts } from "./alerts.js";
import { startMessages } from "./announce.js";
import { createCharts } from "./charts.js";
import { CommandHistory } from "./command_history.js";
import { EmergencyStop } from "./emergency_stop.js";
import { Live } from "./live.js";
import { Mission } from "./mission.js";
import * as net from "./net.js";
import { Panel } from "./panel.js";
import { Roster } from "./roster.js";
import { StateLine } from "./state_line.js";
import { Tabs } from "./tabs.js";
import { startThemeButton } from "./theme_button.js";

const TICK_MS = 1000;
// A gateway that falls silent causes no event.
const LOOK_AGAIN_MS = 5000;
const RATES_MS = 15_000;
const N_COMMANDS = 30;

const element = (id) => document.getElementById(id);

// The stop first: nothing that fails below may keep it from working.
new EmergencyStop({ button: element("emergency"), panel: element("stop-panel"), title: element("stop-title"), lines: element("stop-lines"), close: element("stop-close") });

startMessages();
startThemeButton();
new Panel({ panel: element("help"), opener: element("help-open") });
const tabs = new Tabs({ list: element("tabs") });
const live = new Live();
const account = new Account({ onChange: () => live.restart() });
const onSwarm = (kind) => {
  tabs.want(element("tab-biobots"));
  roster.showOnly(kind);
};
const stateLine = new StateLine({ live, onSwarm });
const onPlace = (place) => {
  tabs.showMap();
  document.dispatchEvent(new CustomEvent("charts:show-place", { detail: { place } }));
};
const roster = new Roster({ account, live, onCounts: (counts, n) => stateLine.showSwarm(counts, n), onPlace });
const mission = new Mission({ panel: element("mission"), account, live });
const history = new CommandHistory({ panel: element("mission") });
const onBiobot = (key) => {
  tabs.want(element("tab-biobots"));
  roster.find(key);
};
const alerts = new Alerts({ panel: element("alerts"), badge: element("alert-badge"), account, live, onBiobot, onLow: (low) => roster.setLow(low) });

const fetchers = Object.fromEntries(Object.entries({ biobots: "/api/v1/biobots", mission: "/api/v1/mission" }).map(([name, path]) => [name, net.makeFetcher(path)]));
let missions = { phase: null, gateways: [] };
let gateways = [];

async function refreshBiobots() {
  const answer = await fetchers.biobots();
  live.noteServerTime(answer.now_wall_ns);
  gateways = answer.gateways;
  stateLine.showGateways(gateways);
  roster.show(answer);
  showMission();
}

async function refreshMission() {
  missions = await fetchers.mission();
  showMission();
}

function showMission() {
  stateLine.showMission(missions);
  mission.show(missions, gateways.map(({ name }) => name));
}

async function refreshRates() {
  // Before the first map there are none, which the mapper tells as an error.
  if (!stateLine.hasMap) return;
  const { biobots } = await net.getJson("/api/v1/coverage");
  roster.setRates(new Map(biobots.map(({ key, per_minute: rate }) => [key, rate])));
}

async function lookAgain() {
  if (!live.isUp) return;
  stateLine.showHealth(await net.getJson("/healthz"));
  stateLine.showMap(await net.getJson("/api/v1/map/status"));
  await refreshBiobots();
}

/** Do it now and then; what fails is tried again the next time, and the state line says if the mapper is away. */
function every(ms, task) {
  setInterval(() => task().catch((problem) => problem.status === undefined && console.error(problem)), ms);
}

live.follow(["map", "biobots", "commands"], refreshBiobots);
live.follow(["mission"], refreshMission);
// Whoever looks may be somebody else to a mapper that was away.
live.onState(() => live.isUp && account.refresh().catch(() => {}));
live.follow(["map", "records"], async () => {
  const hadMap = stateLine.hasMap;
  stateLine.showMap(await net.getJson("/api/v1/map/status"));
  if (stateLine.hasMap && !hadMap) await refreshRates();
});
live.follow(["map"], async () => stateLine.showHealth(await net.getJson("/healthz")));
live.follow(["alerts"], () => alerts.refresh());
live.follow(["commands"], async () => history.show(await net.getJson(`/api/v1/commands?limit=${N_COMMANDS}`)));
every(RATES_MS, async () => live.isUp && refreshRates());
every(LOOK_AGAIN_MS, lookAgain);
setInterval(() => [stateLine, roster, mission, alerts].forEach((part) => part.tick()), TICK_MS);

const charts = createCharts({ headline: element("headline"), map: element("map"), shape: element("shape"), live, net, account });
every(RATES_MS, async () => live.isUp && charts.expectAgain());
// Who does not answer now is asked by the event stream, again and again.
account.refresh().catch(() => {}).finally(() => live.run());
