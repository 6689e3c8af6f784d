// What can be done with the place on the map that was tapped: name it, or have a way begin or end there.

import { make } from "./dom.js";

export class SpotPanel {
  constructor(stage, canvas, { onName, onFrom, onTo, onClose }) {
    Object.assign(this, { stage, canvas, onClose });
    const button = (text, action) => make("button", { type: "button", onclick: () => { this.hide(); action(); } }, text);
    this.first = button("Name", onName);
    this.panel = make("div", { id: "spot", className: "spot", role: "group", "aria-label": "The place that was chosen on the map", hidden: true },
      make("span", {}, "This place"), this.first, button("Way from", onFrom), button("Way to", onTo),
      make("button", { type: "button", "aria-label": "Close", onclick: () => this.close() }, "✕"));
    this.panel.addEventListener("keydown", (event) => event.key === "Escape" && this.close());
    stage.append(this.panel);
  }

  /** Beside a pixel of the canvas; the first button has the focus, so that keys go on from there. */
  show([x, y]) {
    this.panel.hidden = false;
    const { clientWidth: width, clientHeight: height } = this.stage;
    this.panel.style.left = `${Math.max(6, Math.min(x - this.panel.offsetWidth / 2, width - this.panel.offsetWidth - 6))}px`;
    this.panel.style.top = `${y + 20 + this.panel.offsetHeight > height ? Math.max(6, y - this.panel.offsetHeight - 20) : y + 20}px`;
    this.first.focus({ preventScroll: true });
  }

  hide() {
    this.panel.hidden = true;
  }

  close() {
    this.hide();
    this.onClose();
    this.canvas.focus({ preventScroll: true });
  }
}
