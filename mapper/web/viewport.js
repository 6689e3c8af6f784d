// Which part of the map the canvas shows: scale and shift between map coordinates (y upwards) and pixels (y downwards). No drawing.

const MOST_IN = 200, MOST_OUT = 4;

export class Viewport {
  constructor() {
    Object.assign(this, { scale: 1, x: 0, y: 0, fitScale: 1, isFitted: true });
  }

  /** Take the size of the canvas [px] and the bounds of what is drawn {left, right, low, high}; move only where all is to be in sight. */
  setStage(width, height, bounds, padding) {
    const across = bounds.right - bounds.left, up = bounds.high - bounds.low;
    const room = [Math.max(width - padding.left - padding.right, 1), Math.max(height - padding.top - padding.bottom, 1)];
    this.fitScale = across > 0 || up > 0 ? Math.min(room[0] / (across || 1e-12), room[1] / (up || 1e-12)) : 1;
    if (!this.isFitted) return;
    this.scale = this.fitScale;
    this.x = padding.left + room[0] / 2 - (this.scale * (bounds.left + bounds.right)) / 2;
    this.y = padding.top + room[1] / 2 + (this.scale * (bounds.low + bounds.high)) / 2;
  }

  /** Enlarge by a factor; what is at the pixel `at` stays there. */
  zoom(factor, at) {
    const next = Math.min(Math.max(this.scale * factor, this.fitScale / MOST_OUT), this.fitScale * MOST_IN);
    const ratio = next / this.scale;
    this.x = at[0] - (at[0] - this.x) * ratio;
    this.y = at[1] - (at[1] - this.y) * ratio;
    this.scale = next;
    this.isFitted = false;
  }

  move(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.isFitted = false;
  }

  /** Bring a place into the middle of a canvas of this size. */
  centre([x, y], width, height) {
    this.x = width / 2 - this.scale * x;
    this.y = height / 2 + this.scale * y;
    this.isFitted = false;
  }

  toScreen([x, y]) {
    return [this.x + this.scale * x, this.y - this.scale * y];
  }

  toMap([x, y]) {
    return [(x - this.x) / this.scale, (this.y - y) / this.scale];
  }

  copy() {
    return { scale: this.scale, x: this.x, y: this.y };
  }
}
