// A panel that opens and closes over the page. It is never modal: the stop of all stays in reach whatever is open.

// What gets the focus when a panel opens: what is marked so, else what is to be filled in, else what is to be read.
const FIRST = ["[data-first]", "input", "[tabindex='-1']", "button"];

const open = new Set();

export class Panel {
  /** Without an `opener`, the one that is given to `open` has opened it. */
  constructor({ panel, opener = null, onOpen = () => {}, onClose = () => {} }) {
    Object.assign(this, { panel, opener, onOpen, onClose });
    if (opener) {
      opener.setAttribute("aria-expanded", "false");
      opener.setAttribute("aria-controls", panel.id);
      opener.addEventListener("click", () => (panel.hidden ? this.open() : this.close()));
    }
    panel.querySelector("[data-close]").addEventListener("click", () => this.close());
    panel.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.close();
    });
  }

  open(opener = this.opener) {
    if (opener !== this.opener) this.opener?.setAttribute("aria-expanded", "false");
    this.opener = opener;
    open.forEach((other) => other !== this && other.close({ keepFocus: true }));
    open.add(this);
    this.onOpen();
    this.panel.hidden = false;
    this.opener.setAttribute("aria-expanded", "true");
    const controls = FIRST.flatMap((selector) => [...this.panel.querySelectorAll(selector)]);
    controls.find((control) => control.getClientRects().length)?.focus();
  }

  close({ keepFocus = false } = {}) {
    if (this.panel.hidden) return;
    const hadFocus = this.panel.contains(document.activeElement);
    open.delete(this);
    this.panel.hidden = true;
    this.opener.setAttribute("aria-expanded", "false");
    if (hadFocus && !keepFocus) this.opener.focus();
    this.onClose();
  }
}
