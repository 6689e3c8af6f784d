// Brings rows up to date without a long frame: those in sight in the next one, the others in short steps after it.

const STEP_MS = 4;

export class RowPainter {
  /** `paint(row)` brings one up to date; a row has its `element`. */
  constructor({ paint }) {
    this.paint = paint;
    this.stale = new Set();
    this.inSight = new Set();
    this.rows = new Map();
    this.isWaiting = false;
    this.observer = new IntersectionObserver((entries) => this.onSight(entries));
  }

  add(row) {
    this.rows.set(row.element, row);
    this.observer.observe(row.element);
  }

  remove(row) {
    this.observer.unobserve(row.element);
    this.rows.delete(row.element);
    this.inSight.delete(row);
    this.stale.delete(row);
  }

  /** Paint all of them soon. */
  refresh() {
    this.rows.forEach((row) => this.stale.add(row));
    this.wake();
  }

  onSight(entries) {
    for (const { target, isIntersecting } of entries) {
      const row = this.rows.get(target);
      if (row && isIntersecting) this.inSight.add(row);
      else this.inSight.delete(row);
    }
    if (this.stale.size) this.wake();
  }

  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => {
      this.isWaiting = false;
      this.step();
    });
  }

  step() {
    const until = performance.now() + STEP_MS;
    for (const row of this.inSight) if (this.stale.delete(row)) this.paint(row);
    for (const row of this.stale) {
      if (performance.now() >= until) break;
      this.stale.delete(row);
      this.paint(row);
    }
    if (this.stale.size) this.wake();
  }
}
