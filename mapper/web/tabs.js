// Which of the panels is shown: beside the map on a desk, in its place on a phone.

const NARROW = "(max-width: 900px)";

export class Tabs {
  constructor({ list }) {
    this.tabs = [...list.querySelectorAll("[role='tab']")];
    this.narrow = matchMedia(NARROW);
    this.wasChosen = null;
    this.tabs.forEach((tab) => tab.addEventListener("click", () => this.want(tab)));
    list.addEventListener("keydown", (event) => this.onKey(event));
    this.narrow.addEventListener("change", () => this.arrange());
    this.arrange();
  }

  /** The map is always there where there is room; on a phone it is one of the panels, and the first. What was chosen stays. */
  arrange() {
    const [map, first] = this.tabs;
    map.hidden = !this.narrow.matches;
    if (this.narrow.matches) this.choose(this.wasChosen ?? map);
    else this.choose(this.wasChosen === null || this.wasChosen === map ? first : this.wasChosen);
  }

  /** Bring the map into view: on a desk it is. */
  showMap() {
    if (this.narrow.matches) this.want(this.tabs[0]);
  }

  /** Show what somebody wants to see. */
  want(tab) {
    this.wasChosen = tab;
    this.choose(tab);
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
    this.want(tab);
    tab.focus();
  }
}
