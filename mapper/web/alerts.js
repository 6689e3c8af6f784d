// Alerts: what a person should know or do something about. New ones are spoken; acknowledging says that somebody has seen it.

import { say, tell } from "./announce.js";
import { AlertGroup, AlertItem, biobotOf } from "./alert_item.js";
import { make, setText } from "./dom.js";
import { count } from "./format.js";
import { getJson, send } from "./net.js";

const RANK = { critical: 0, warning: 1, info: 2 };
const TRIES = 2;
const MAX_SPOKEN = 3;
const LIMIT = 1000;
// So many of a kind are still shown one by one.
const MAX_SINGLE = 3;

export class Alerts {
  constructor({ panel, badge, account, live, onBiobot, onLow }) {
    Object.assign(this, { badge, account, live, onBiobot, onLow });
    this.known = null;
    this.items = new Map();
    this.groups = { on: new Map(), over: new Map() };
    this.now = make("ul", { className: "alert-list", "aria-label": "Alerts that hold" });
    this.over = make("ul", { className: "alert-list over", "aria-label": "Alerts that are over" });
    this.none = make("p", { className: "empty" }, "No alert is in force.");
    this.past = make("details", {}, make("summary", {}, "Over"), this.over);
    panel.append(make("div", { className: "scroll" }, this.none, this.now, this.past));
  }

  async refresh() {
    this.show((await getJson(`/api/v1/alerts?limit=${LIMIT}`)).alerts);
  }

  show(alerts) {
    const sorted = [...alerts].sort((a, b) => RANK[a.severity] - RANK[b.severity] || b.since_wall_ns - a.since_wall_ns);
    const on = sorted.filter((alert) => alert.is_on), over = sorted.filter((alert) => !alert.is_on);
    this.fillGrouped(this.now, "on", on);
    this.fillGrouped(this.over, "over", over);
    const kept = new Set(alerts.map(({ id }) => id));
    [...this.items.keys()].filter((id) => !kept.has(id)).forEach((id) => this.remove(id));
    this.none.hidden = on.length > 0;
    this.past.hidden = over.length === 0;
    setText(this.past.firstElementChild, `Over (${count(over.length)})`);
    const open = on.filter((alert) => !alert.acknowledged_by && alert.severity !== "info");
    this.badge.hidden = open.length === 0;
    this.badge.className = `badge ${open[0]?.severity ?? ""}`;
    if (open.length) this.badge.replaceChildren(count(open.length), make("span", { className: "unseen" }, " not acknowledged"));
    this.speak(on);
    this.onLow(new Set(on.filter(({ kind }) => kind === "battery_low").map(biobotOf)));
  }

  /** Those that are there when the page opens are on the badge; later ones are spoken. */
  speak(on) {
    const fresh = this.known === null ? [] : on.filter(({ id }) => !this.known.has(id));
    this.known = new Set([...(this.known ?? []), ...on.map(({ id }) => id)]);
    if (!fresh.length) return;
    const told = fresh.slice(0, MAX_SPOKEN).map((alert) => `${alert.severity}: ${alert.text}`);
    const more = fresh.length > MAX_SPOKEN ? ` And ${count(fresh.length - MAX_SPOKEN)} more alerts.` : "";
    say(told.join(" ") + more, { isUrgent: fresh[0].severity === "critical" });
  }

  fill(list, alerts) {
    this.put(list, alerts.map((alert) => this.itemOf(alert).element));
  }

  /** Those that hold, or that are over: many of a kind in one entry, which stands where the first of them would. */
  fillGrouped(list, name, alerts) {
    const groups = this.groups[name];
    const kinds = new Map();
    alerts.forEach((alert) => kinds.set(alert.kind, [...(kinds.get(alert.kind) ?? []), alert]));
    const grouped = new Map([...kinds].filter(([, ofKind]) => ofKind.length > MAX_SINGLE));
    for (const [kind, ofKind] of grouped) {
      if (!groups.has(kind)) groups.set(kind, new AlertGroup({ kind, account: this.account, onAcknowledge: (ids) => this.acknowledge(ids) }));
      groups.get(kind).show(ofKind);
      this.fill(groups.get(kind).list, ofKind);
    }
    this.put(list, [...new Set(alerts.map((alert) => (grouped.has(alert.kind) ? groups.get(alert.kind) : this.itemOf(alert)).element))]);
    [...groups.keys()].filter((kind) => !grouped.has(kind)).forEach((kind) => {
      groups.get(kind).remove();
      groups.delete(kind);
    });
  }

  itemOf(alert) {
    const item = this.items.get(alert.id) ?? this.addItem(alert.id);
    item.show(alert, this.live.serverNow());
    return item;
  }

  /** Have these elements in a list, in this order; what is in its place stays untouched. */
  put(list, elements) {
    let place = list.firstElementChild;
    for (const element of elements) {
      if (element === place) place = place.nextElementSibling;
      else list.insertBefore(element, place);
    }
  }

  addItem(id) {
    const item = new AlertItem({ id, account: this.account, onAcknowledge: () => this.acknowledge([id]), onBiobot: this.onBiobot });
    this.items.set(id, item);
    return item;
  }

  remove(id) {
    this.items.get(id).remove();
    this.items.delete(id);
  }

  async acknowledge(ids) {
    try {
      for (const id of ids) await send("POST", `/api/v1/alerts/${id}/acknowledgement`, undefined, { tries: TRIES });
      await this.refresh();
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      tell(problem.text, false);
    }
  }

  tick() {
    this.items.forEach((item) => item.tick(this.live.serverNow()));
  }
}
