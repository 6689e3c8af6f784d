// One alert in the list, and many of a kind in one entry.

import { make, makeButton, setText } from "./dom.js";
import { age, clock, count, secondsOf } from "./format.js";

const BIOBOT = /^biobot (\d+)$/;

// What many of a kind are called, after their number.
const MANY = {
  biobot_lost: "biobots lost",
  biobot_stuck: "biobots stuck",
  battery_low: "batteries low",
  gateway_away: "gateways away",
  gateway_event: "events at gateways",
  gateway_fault: "faults of gateways",
  radio_down: "radios down",
  disk_full: "disks full",
  landmark_lost: "landmarks lost",
  new_hole: "new holes",
  hole_vanished: "holes vanished",
};

/** The key of the biobot that an alert is about, or null. */
export function biobotOf({ subject }) {
  return BIOBOT.exec(subject)?.[1] ?? null;
}

export class AlertItem {
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
    this.biobot = biobotOf(alert);
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

/** Many alerts of a kind: how many, about whom, and one button for all of them. */
export class AlertGroup {
  constructor({ kind, account, onAcknowledge }) {
    Object.assign(this, { kind, account });
    this.severity = make("span", { className: "severity" });
    this.title = make("strong");
    this.subjects = make("span", { className: "note" });
    this.list = make("ul", { className: "alert-list" });
    this.acknowledge = makeButton("", () => onAcknowledge(this.open.map(({ id }) => id)));
    const summary = make("summary", { className: "alert-head" }, this.severity, this.title, this.subjects);
    this.element = make("li", {}, make("details", {}, summary, this.list), make("div", { className: "actions" }, this.acknowledge));
    account.guard(this.acknowledge, "operator");
  }

  show(alerts) {
    const words = MANY[this.kind] ?? `alerts: ${this.kind.replaceAll("_", " ")}`;
    this.open = alerts.filter((alert) => !alert.acknowledged_by);
    this.element.className = `${alerts[0].severity} group ${this.open.length ? "" : "seen"}`;
    setText(this.severity, alerts[0].severity);
    setText(this.title, `${count(alerts.length)} ${words}`);
    setText(this.subjects, alerts.map(({ subject }) => subject.replace(/^biobot /, "")).join(", "));
    setText(this.acknowledge, `Acknowledge all (${count(this.open.length)})`);
    this.acknowledge.setAttribute("aria-label", `Acknowledge all (${count(this.open.length)}): ${words}`);
    this.acknowledge.hidden = this.open.length === 0;
  }

  remove() {
    this.account.forget(this.acknowledge);
    this.element.remove();
  }
}
