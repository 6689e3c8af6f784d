// Maps of the past as the service keeps them; those that were looked at are remembered, because a map of one version never changes.

const PAGE = 500;
const REMEMBERED = 40;

export class PastMaps {
  constructor(net) {
    this.net = net;
    this.known = new Map();
  }

  /** All that are kept, the oldest first. */
  async list() {
    const found = [];
    for (let after = 0; ; ) {
      const page = await this.net.getJson(`/api/v1/maps?after=${after}&limit=${PAGE}`);
      found.push(...page.maps);
      if (page.next === null || page.next === undefined) return found;
      after = page.next;
    }
  }

  map(version) {
    return this.remember(`/api/v1/maps/${version}`);
  }

  diagram(version) {
    return this.remember(`/api/v1/maps/${version}/diagram`);
  }

  /** What has changed from one map to a later one, in words. */
  async changeBetween(earlier, later) {
    const { summary } = await this.remember(`/api/v1/maps/${later}/difference?since=${earlier}`);
    return summary.join("; ").replaceAll("+-", "±").replaceAll("->", "→");
  }

  async remember(path) {
    if (!this.known.has(path)) {
      const asked = this.net.getJson(path);
      this.known.set(path, asked);
      asked.catch(() => this.known.delete(path));
      if (this.known.size > REMEMBERED) this.known.delete(this.known.keys().next().value);
    }
    return this.known.get(path);
  }
}
