// The controls beside the picture; those that do nothing as things are, are off.

import { fileName, filmType, fullFrame } from "lfrender/files";
import { depthOrder, patchSize } from "lfrender/geometry";
import { describePlane } from "lfrender/readout";
import { bytes } from "lfrender/scene";

const $ = id => document.getElementById(id);

const NAMES = { focus: "one depth in focus", range: "sharp in a range", sharp: "sharp everywhere", tiles: "tiles", traditional: "traditional" };

export function showStatus(words) {
  $("status").textContent = words;
}

export function controlPage(viewer) {
  const { scene } = viewer, { pitch } = scene, on = (id, event, action) => $(id).addEventListener(event, action);
  for (const id of ["plane", "from", "to"]) [$(id).min, $(id).max] = scene.planes;
  on("plane", "input", event => viewer.move({ plane: patchSize(Number(event.target.value), pitch) }));
  for (const id of ["from", "to"]) on(id, "input", () => viewer.move({ range: heldRange(id) }));
  on("aperture", "input", event => viewer.move({ aperture: Number(event.target.value) }));
  on("brightness", "input", event => viewer.move({ brightness: Number(event.target.value) }));
  for (const choice of document.getElementsByName("mode")) choice.addEventListener("change", () => viewer.set({ mode: choice.value }));
  on("overlay", "change", event => viewer.set({ overlay: event.target.checked ? 0.6 : 0 }));
  on("stereo", "change", event => viewer.view(event.target.value));
  on("compare", "change", event => viewer.compare(event.target.checked));
  on("keep", "click", () => viewer.keep());
  on("measure", "change", event => viewer.measure(event.target.checked));
  on("centre", "click", () => viewer.set({ q: [0, 0] }));
  on("in", "click", () => viewer.zoom(1.25));
  on("out", "click", () => viewer.zoom(0.8));
  on("full", "click", () => viewer.full());
  on("fit", "click", () => viewer.fit());
  on("screen", "click", () => viewer.fullScreen());
  on("save", "click", () => viewer.save());
  on("film", "click", () => viewer.saveFilm($("film-kind").value));
  $("screen").hidden = !document.fullscreenEnabled;
  if (!filmType()) Object.assign($("film"), { disabled: true, title: "This browser records no films" });
  controlLine(viewer);
  const [far, near] = scene.overlay.ends, ramp = bytes(scene.overlay.ramp), stops = [];
  for (let n = 0; n < 256; n += 15) stops.push(`rgb(${ramp.slice(3 * n, 3 * n + 3).join(" ")})`);
  $("ramp").style.background = `linear-gradient(to right, ${stops})`;
  $("low").textContent = far;
  $("high").textContent = near;
  $("about").textContent = `${scene.size.join(" × ")} px, pitch ${pitch.toFixed(2)} px`;
}

// The ends of the sliders; the one that is not held gives way.
function heldRange(held) {
  const [from, to] = ["from", "to"].map(id => Number($(id).value));
  return held === "from" ? [from, Math.max(from, to)] : [Math.min(from, to), to];
}

// The line between A and B, by mouse, finger and keys.
function controlLine(viewer) {
  const line = $("line"), place = at => {
    viewer.line = Math.min(Math.max(at, 0), 1);
    viewer.move({});
  };
  line.addEventListener("pointerdown", event => {
    line.setPointerCapture(event.pointerId);
    event.preventDefault();
    line.focus();
  });
  line.addEventListener("pointermove", event => {
    const stage = line.parentElement.getBoundingClientRect();
    if (line.hasPointerCapture(event.pointerId)) place((event.clientX - stage.left) / stage.width);
  });
  line.addEventListener("keydown", event => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    place(viewer.line + step);
  });
}

export function showSettings(viewer) {
  const { scene, settings, frame, compared, line } = viewer, { mode, range, plane, q } = settings, { pitch } = scene;
  const aside = q.some(n => n) || settings.stereo !== "";
  const near = { plane: depthOrder(plane, pitch), from: range[0], to: range[1] };
  for (const id of ["plane", "from", "to"]) {
    const words = describePlane(patchSize(near[id], pitch), pitch, id === "plane");
    $(id).value = near[id];
    $(id).setAttribute("aria-valuetext", words);
    $(`${id}-value`).textContent = words;
  }
  $("one-depth").hidden = mode === "range";
  $("two-depths").hidden = mode !== "range";
  // Sharp everywhere, the plane is that of the places which do not move with the viewpoint.
  $("plane").disabled = mode === "traditional" || (mode === "sharp" && !aside);
  $("plane-name").textContent = mode === "sharp" ? "Depth that stays in place" : "Plane in focus";
  $("aperture").value = settings.aperture;
  $("aperture").disabled = mode !== "focus" && mode !== "range";
  $("aperture-value").textContent = `${Math.round(100 * settings.aperture)} %`;
  $("brightness").value = settings.brightness;
  $("brightness-value").textContent = `${settings.brightness > 0 ? "+" : settings.brightness < 0 ? "−" : ""}${Math.abs(settings.brightness).toFixed(1)} EV`;
  const [x, y] = q.map(n => Math.round((100 * n) / scene.radius));
  $("viewpoint").textContent = x || y ? `${x} %, ${y} %` : "centre";
  $("centre").disabled = !q.some(n => n);
  $("zoom").textContent = `${Math.round((100 * pitch) / (frame.spacing * scene.scale))} %`;
  $("fit").disabled = viewer.fitted;
  $("overlay").checked = settings.overlay > 0;
  $("legend").hidden = !settings.overlay;
  $("stereo").value = settings.stereo;
  $("stereo").disabled = compared;
  $("compare").checked = compared;
  $("measure").checked = viewer.measuring;
  $("line").hidden = !compared;
  const [a, b] = $("line").children;
  a.textContent = `A ${NAMES[mode]}`;
  b.textContent = `B ${NAMES[viewer.comparison().mode]}`;
  $("line").style.left = `${100 * line}%`;
  $("line").setAttribute("aria-valuenow", Math.round(100 * line));
  for (const choice of document.getElementsByName("mode")) choice.checked = choice.value === mode;
  if (!viewer.width) return;
  const size = fullFrame(viewer).size;
  $("save").title = fileName(viewer, ".png");
  $("save").textContent = `Save as PNG, ${settings.stereo === "side" ? 2 * size[0] : size[0]} × ${size[1]} px`;
}
