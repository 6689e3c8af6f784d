// Alerts: what a person should know or do something about. New ones are spoken; acknowledging says that somebody has seen it.

import { say, tell } from "./announce.js";
import { make, makeButton, setText } from "./dom.js";
import { age, clock, count, secondsOf } from "./format.js";
import { getJson, send } from "./net.js";

const RANK = { critical: 0, warning: 1, info: 2 };
const BIOBOT = /^biobot (\d+)$/;
const TRIES = 2;
const MAX_SPOKEN = 3;
const LIMIT = 1000;

export class Alerts {
  constructor({ panel, badge, account, live, onBiobot, onLow }) {
    Object.assign(this, { badge, account, live, onBiobot, onLow });
    this.known = null;
    this.items = new Map();
    this.now = make("ul", { className: "alert-list", "aria-label": "Alerts that hold" });
    this.over = make("ul", { className: "alert-list over", "aria-label": "Alerts that are over" });
    this.none = make("p", { className: "empty" }, "Nothing is wrong.");
    this.past = make("details", {}, make("summary", {}, "Over"), this.over);
    panel.append(make("div", { className: "scroll" }, this.none, this.now, this.past));
  }

  async refresh() {
    this.show((await getJson(`/api/v1/alerts?limit=${LIMIT}`)).alerts);
  }

  show(alerts) {
    const sorted = [...alerts].sort((a, b) => RANK[a.severity] - RANK[b.severity] || b.since_wall_ns - a.since_wall_ns);
    const on = sorted.filter((alert) => alert.is_on), over = sorted.filter((alert) => !alert.is_on);
    this.fill(this.now, on);
    this.fill(this.over, over);
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
    this.onLow(new Set(on.filter(({ kind }) => kind === "battery_low").map(({ subject }) => BIOBOT.exec(subject)?.[1])));
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
    let place = list.firstElementChild;
    for (const alert of alerts) {
      const item = this.items.get(alert.id) ?? this.addItem(alert.id);
      item.show(alert, this.live.serverNow());
      if (item.element === place) place = place.nextElementSibling;
      else list.insertBefore(item.element, place);
    }
  }

  addItem(id) {
    const item = new AlertItem({ id, account: this.account, onAcknowledge: () => this.acknowledge(id), onBiobot: this.onBiobot });
    this.items.set(id, item);
    return item;
  }

  remove(id) {
    this.items.get(id).remove();
    this.items.delete(id);
  }

  async acknowledge(id) {
    try {
      await send("POST", `/api/v1/alerts/${id}/acknowledgement`, undefined, { tries: TRIES });
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

class AlertItem {
  constructor({ account, onAcknowledge, onBiobot }) {
    this.account = account;
    this.severity = make("span", { className: "severity" });
    this.subject = make("strong");
    this.text = make("p");
    this.when = make("p", { className: "note" });
    this.acknowledge = makeButton("Acknowledge", onAcknowledge);
    this.find = makeButton("Show", () => onBiobot(this.biobot), { hidden: true });
    this.element = make("li", {},
      make("div", { className: "alert-head" }, this.severity, this.subject, this.when), this.text, make("div", { className: "actions" }, this.acknowledge, this.find));
    account.guard(this.acknowledge, "operator");
  }

  show(alert, nowS) {
    this.alert = alert;
    this.element.className = alert.is_on && !alert.acknowledged_by ? alert.severity : `${alert.severity} seen`;
    setText(this.severity, alert.severity);
    setText(this.subject, alert.subject);
    setText(this.text, alert.text);
    this.acknowledge.hidden = Boolean(alert.acknowledged_by);
    this.acknowledge.setAttribute("aria-label", `Acknowledge: ${alert.subject}, ${alert.kind}`);
    this.biobot = BIOBOT.exec(alert.subject)?.[1] ?? null;
    this.find.hidden = this.biobot === null;
    this.find.setAttribute("aria-label", `Show biobot ${this.biobot} in the table`);
    this.tick(nowS);
  }

  tick(nowS) {
    const { since_wall_ns: sinceNs, ended_wall_ns: endedNs, is_on: isOn, acknowledged_by: by, acknowledged_wall_ns: byNs } = this.alert;
    const since = secondsOf(sinceNs);
    const seen = by ? ` · acknowledged by ${by} at ${clock(secondsOf(byNs))}` : "";
    setText(this.when, (isOn ? `since ${clock(since)} (${age(nowS - since)})` : `from ${clock(since)} to ${clock(secondsOf(endedNs))}`) + seen);
  }

  remove() {
    this.account.forget(this.acknowledge);
    this.element.remove();
  }
}
