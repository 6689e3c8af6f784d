// What can be taken away: pictures, map data, encounters, the report.

import { make, setText } from "./dom.js";

const FILES = [
  ["Mission report", [["HTML to print", "/api/v1/report.html?download=true", "report.html"]]],
  ["Map", [["SVG", "/api/v1/map.svg", "map.svg"], ["PNG", "/api/v1/map.png", "map.png"], ["GeoJSON", "/api/v1/map.geojson", "map.geojson"], ["JSON", "/api/v1/map", "map.json"]]],
  ["Diagram", [["SVG", "/api/v1/diagram.svg", "diagram.svg"], ["PNG", "/api/v1/diagram.png", "diagram.png"], ["JSON", "/api/v1/diagram", "diagram.json"]]],
  ["Barcode", [["SVG", "/api/v1/barcode.svg", "barcode.svg"], ["PNG", "/api/v1/barcode.png", "barcode.png"]]],
  ["Encounters", [["CSV", "/api/v1/encounters.csv", "encounters.csv"], ["Parquet", "/api/v1/encounters.parquet", "encounters.parquet"]]],
];

export class ExportsPanel {
  /** `save(path, name)` fetches and keeps a file; a promise that fails with a problem that has `text`. */
  constructor(root, { save }) {
    this.save = save;
    this.outcome = make("p", { className: "outcome", role: "status", id: "export-outcome" });
    const rows = FILES.map(([what, files]) => make("div", { className: "export-row", role: "group", "aria-label": what },
      make("span", {}, what), ...files.map(([form, path, name]) => make("button", { type: "button", "aria-label": `Save ${what.toLowerCase()} as ${form}`, onclick: () => this.take(path, name) }, form))));
    root.replaceChildren(...rows, make("p", { className: "note" }, "Files are of the newest map, not of one of the past."), this.outcome);
  }

  async take(path, name) {
    this.tell(`${name} is being fetched …`, null);
    try {
      await this.save(path, name);
      this.tell(`${name} is saved.`, true);
    } catch (problem) {
      if (problem.text === undefined) throw problem;
      this.tell(`${name}: ${problem.text}`, false);
    }
  }

  tell(text, isFine) {
    setText(this.outcome, text);
    this.outcome.className = `outcome ${isFine === null ? "" : isFine ? "good" : "bad"}`;
  }
}
