// Mouse, fingers and keys on a canvas, told as what they ask for: to move, to enlarge, to look at a place, to take one.

const STILL_PX = 5;
const STEP_PX = 40;
const KEY_ZOOM = 1.3;

/** `on`: {move(dx, dy), zoom(factor, [x, y]), fit(), hover([x, y] | null), tap([x, y]), key(name)}; places in pixels of the canvas. */
export function listen(canvas, on) {
  const fingers = new Map();
  let travelled = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (!fingers.size) travelled = 0;
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    const now = [event.offsetX, event.offsetY];
    if (!before) return on.hover(now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    travelled += Math.hypot(dx, dy);
    if (fingers.size === 1 && travelled < STILL_PX) return;
    fingers.set(event.pointerId, now);
    if (fingers.size === 1) return on.move(dx, dy);
    travelled = Infinity;
    const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
    const spread = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
    on.move(dx / 2, dy / 2);
    on.zoom(spread(now) / spread(before), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
  });
  canvas.addEventListener("pointerup", (event) => {
    const isTap = fingers.size === 1 && travelled < STILL_PX;
    fingers.delete(event.pointerId);
    if (isTap) on.tap([event.offsetX, event.offsetY]);
  });
  canvas.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => on.hover(null));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    on.zoom(Math.exp(-event.deltaY / 400), [event.offsetX, event.offsetY]);
  }, { passive: false });
  const middle = () => [canvas.clientWidth / 2, canvas.clientHeight / 2];
  const keys = {
    ArrowLeft: () => on.move(STEP_PX, 0), ArrowRight: () => on.move(-STEP_PX, 0),
    ArrowUp: () => on.move(0, STEP_PX), ArrowDown: () => on.move(0, -STEP_PX),
    "+": () => on.zoom(KEY_ZOOM, middle()), "=": () => on.zoom(KEY_ZOOM, middle()), "-": () => on.zoom(1 / KEY_ZOOM, middle()), 0: () => on.fit(),
    Enter: () => on.tap(middle()), Escape: () => on.hover(null),
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
}
