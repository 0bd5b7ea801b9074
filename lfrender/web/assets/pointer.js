// Mouse, fingers and keys on the picture.

import { clamp } from "lfrender/geometry";

const CLICK = 4; // px a click may move

const place = event => [event.offsetX * devicePixelRatio, event.offsetY * devicePixelRatio];

export function controlPointer(viewer) {
  const { canvas } = viewer, down = new Map();
  let start, travelled = 0;
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    viewer.endHint();
    down.set(event.pointerId, place(event));
    start = { pan: event.shiftKey || event.button !== 0, several: down.size > 1 };
    if (down.size === 1) travelled = 0;
  });
  canvas.addEventListener("pointermove", event => {
    const before = down.get(event.pointerId);
    if (!before) return viewer.hover(...place(event));
    const now = place(event), [du, dv] = now.map((n, k) => n - before[k]);
    down.set(event.pointerId, now);
    travelled += Math.hypot(du, dv) / devicePixelRatio;
    if (travelled <= CLICK) return;
    canvas.classList.add("moving");
    if (down.size > 1) pinch(viewer, [...down.values()], before, now);
    else if (start.pan) viewer.pan(du, dv);
    // A third of the picture's width moves across the whole aperture; near objects follow the hand.
    else viewer.look(-(du / viewer.width) * 6 * viewer.scene.radius, -(dv / viewer.width) * 6 * viewer.scene.radius);
  });
  const end = event => {
    if (!down.delete(event.pointerId)) return;
    canvas.classList.remove("moving");
    if (event.type !== "pointerup" || travelled > CLICK || start.pan || start.several) return;
    viewer.click(...place(event));
    // Fingers do not hover: they see the values of the place that they touch.
    viewer.hover(...place(event));
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("pointerleave", event => event.pointerType === "mouse" && viewer.hover());
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    viewer.zoom(Math.exp(-clamp(event.deltaY * lines, -300, 300) / 500), ...place(event));
  }, { passive: false });
  canvas.addEventListener("keydown", event => key(viewer, event));
}

function pinch(viewer, fingers, before, now) {
  const other = fingers.find(finger => finger !== now);
  const [was, is] = [before, now].map(n => Math.hypot(n[0] - other[0], n[1] - other[1]));
  viewer.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
  if (was > 1) viewer.zoom(is / was, (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
}

function key(viewer, event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  const actions = {
    "+": () => viewer.zoom(1.25), "=": () => viewer.zoom(1.25), "-": () => viewer.zoom(0.8), "0": () => viewer.fit(), "1": () => viewer.full(),
    PageUp: () => viewer.near(0.02), PageDown: () => viewer.near(-0.02), Enter: () => viewer.click((viewer.width - 1) / 2, (viewer.height - 1) / 2),
    ",": () => viewer.aperture(-0.05), ".": () => viewer.aperture(0.05), a: () => viewer.toggle("sharp"), t: () => viewer.toggle("tiles"),
    r: () => viewer.toggle("range"), m: () => viewer.set({ overlay: viewer.settings.overlay ? 0 : 0.6 }), c: () => viewer.set({ q: [0, 0] }),
    b: () => viewer.compare(!viewer.compared), d: () => viewer.measure(!viewer.measuring), f: () => viewer.fullScreen(),
  };
  const turn = () => viewer.look(...arrow.map(n => n * 0.08 * viewer.scene.radius));
  const action = arrow
    ? () => (event.shiftKey ? viewer.pan(-60 * arrow[0], -60 * arrow[1]) : turn())
    : actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action) return;
  event.preventDefault();
  action();
}
