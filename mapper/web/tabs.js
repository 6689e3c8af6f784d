// Which of the panels is shown: beside the map on a desk, in its place on a phone.

const NARROW = "(max-width: 900px)";

export class Tabs {
  constructor({ list }) {
    this.tabs = [...list.querySelectorAll("[role='tab']")];
    this.narrow = matchMedia(NARROW);
    this.tabs.forEach((tab) => tab.addEventListener("click", () => this.choose(tab)));
    list.addEventListener("keydown", (event) => this.onKey(event));
    this.narrow.addEventListener("change", () => this.arrange());
    this.arrange();
  }

  /** The map is always there where there is room; on a phone it is one of the panels, and the first. */
  arrange() {
    this.tabs[0].hidden = !this.narrow.matches;
    this.choose(this.narrow.matches ? this.tabs[0] : this.tabs[1]);
  }

  /** Bring the map into view: on a desk it is. */
  showMap() {
    if (this.narrow.matches) this.choose(this.tabs[0]);
  }

  choose(chosen) {
    for (const tab of this.tabs) {
      const isChosen = tab === chosen;
      tab.setAttribute("aria-selected", String(isChosen));
      tab.tabIndex = isChosen ? 0 : -1;
      const panel = document.getElementById(tab.getAttribute("aria-controls"));
      if (panel.getAttribute("role") === "tabpanel") panel.hidden = !isChosen;
    }
    document.body.dataset.view = chosen.getAttribute("aria-controls");
  }

  onKey(event) {
    const shown = this.tabs.filter((tab) => !tab.hidden);
    const at = shown.indexOf(document.activeElement);
    const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: shown.length - 1 }[event.key];
    if (at < 0 || to === undefined) return;
    event.preventDefault();
    const tab = shown[(to + shown.length) % shown.length];
    this.choose(tab);
    tab.focus();
  }
}
