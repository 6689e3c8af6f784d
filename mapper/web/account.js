// Who looks at this page and what they may do; signing in and out.

import { say, tell } from "./announce.js";
import { getJson, hasToken, setToken } from "./net.js";
import { Panel } from "./panel.js";

const RANKS = { viewer: 0, operator: 1, admin: 2 };
const MAY = {
  viewer: "You may look. Commands need a token with the role operator.",
  operator: "You may look, command biobots and missions, and acknowledge alerts.",
  admin: "You may do everything, also make and revoke tokens.",
};
const NOBODY = { name: null, role: null, is_anonymous: true };

const element = (id) => document.getElementById(id);

export class Account {
  constructor({ onChange }) {
    this.me = NOBODY;
    this.isAsking = false;
    this.onChange = onChange;
    this.guarded = new Map();
    this.panel = new Panel({ panel: element("account"), opener: element("account-open"), onOpen: () => this.showPanel() });
    element("sign-in").addEventListener("submit", (event) => {
      event.preventDefault();
      this.signIn(element("token").value.trim());
    });
    element("sign-out").addEventListener("click", () => this.signOut());
    document.addEventListener("signinwanted", () => this.onRefused());
    // Controls that the role lacks can still be reached and asked why: `disabled` would hide the reason.
    document.addEventListener("click", (event) => this.explain(event), { capture: true });
  }

  /** Ask the mapper who this is; before that nobody is signed in. */
  async refresh() {
    const before = this.me;
    this.me = await getJson("/api/v1/me");
    this.show();
    if (before.name !== this.me.name || before.role !== this.me.role) this.onChange();
  }

  can(role) {
    return (RANKS[this.me.role] ?? -1) >= RANKS[role];
  }

  /** Why the role does not suffice, or null if it does. */
  lack(role) {
    if (this.can(role)) return null;
    const who = this.me.is_anonymous ? "you are not signed in" : `you are signed in as ${this.me.role}`;
    return `This needs the role ${role}; ${who}. Sign in with a token of an ${role}.`;
  }

  /** Disable a control, with the reason, as long as the role does not suffice, or `otherwise()` returns a reason; `review` asks again. */
  guard(control, role, otherwise = () => null) {
    this.guarded.set(control, { role, otherwise });
    this.review(control);
  }

  review(control) {
    const { role, otherwise } = this.guarded.get(control);
    const reason = this.lack(role) ?? otherwise();
    if (reason === null) {
      control.removeAttribute("aria-disabled");
      control.removeAttribute("data-reason");
    } else {
      control.setAttribute("aria-disabled", "true");
      control.dataset.reason = reason;
    }
    control.title = reason ?? "";
  }

  forget(control) {
    this.guarded.delete(control);
  }

  async signIn(token) {
    const input = element("token");
    const fail = (text) => {
      input.setAttribute("aria-invalid", "true");
      element("sign-in-fault").textContent = text;
      say(text, { isUrgent: true });
      input.focus();
    };
    if (!token) return fail("Enter a token first: it begins with biobot_.");
    // It goes into a header, which takes printable ASCII only.
    if (!/^[\x21-\x7e]+$/.test(token)) return fail("This is no token: one has neither spaces nor other letters than A to Z. Copy it whole.");
    try {
      await getJson("/api/v1/me", { as: token });
    } catch (problem) {
      return fail(problem.status === 401 ? "This token opens nothing here, or was revoked. Copy it whole, or ask an administrator for a new one." : problem.text);
    }
    setToken(token);
    await this.refresh();
    input.value = "";
    input.removeAttribute("aria-invalid");
    element("sign-in-fault").textContent = "";
    this.panel.close();
    say(`Signed in as ${this.me.name}, ${this.me.role}.`);
  }

  /** Begin anew as nobody: what this person could see goes from the screen. */
  signOut() {
    setToken(null);
    location.reload();
  }

  /** A token that was valid is not any more, or what was asked for needs one. Whoever may look without one goes on looking. */
  async onRefused() {
    const hadToken = hasToken();
    setToken(null);
    if (hadToken) {
      this.me = NOBODY;
      this.show();
      element("sign-in-fault").textContent = "The token is not valid any more. Sign in again.";
    }
    this.panel.open();
    if (this.isAsking) return;
    this.isAsking = true;
    try {
      await this.refresh();
    } catch (problem) {
      if (problem.status === 401) this.me = NOBODY;
      this.show();
      if (hadToken) this.onChange();
    } finally {
      this.isAsking = false;
    }
  }

  show() {
    const { name, role, is_anonymous: isAnonymous } = this.me;
    element("account-open").textContent = isAnonymous ? "Sign in" : `${name} · ${role}`;
    document.body.dataset.role = role ?? "nobody";
    // The stop is never taken away; it says what will come of it.
    element("emergency-lack").hidden = this.can("operator");
    element("emergency-lack").textContent = isAnonymous ? "sign in first" : `not as ${role}`;
    this.guarded.forEach((_, control) => this.review(control));
    this.showPanel();
  }

  showPanel() {
    const { name, role, is_anonymous: isAnonymous } = this.me;
    element("account-title").textContent = isAnonymous ? "Sign in" : `${name}, ${role}`;
    element("account-words").textContent = isAnonymous && role === null ? "This mapper shows nothing without a token." : MAY[role] ?? "";
    element("sign-in").hidden = !isAnonymous;
    element("sign-out").hidden = isAnonymous;
  }

  explain(event) {
    const control = event.target.closest?.("[data-reason]");
    if (!control) return;
    event.preventDefault();
    event.stopPropagation();
    tell(control.dataset.reason, false);
  }
}
