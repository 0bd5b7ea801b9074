// Pictures and films of the viewer as files, at the full resolution of the flat.

import { clamp, modeName } from "lfrender/geometry";
import { eyes } from "lfrender/composition";

const TILE = 1024; // px drawn at once
const LARGEST = 16384; // px along a side of a picture
const FILM_SIDE = 960; // px
const PICTURES = 48; // of a film: two seconds
const RATE = 24;

// Left, top, width and height [px] of what is in view, with the pixels that the flat is resolved to.
export function fullFrame({ scene, frame, width, height }) {
  const spacing = scene.pitch / scene.scale, [low, high] = [frame.at(-0.5, -0.5, width, height), frame.at(width - 0.5, height - 0.5, width, height)];
  const ends = [0, 1].map(k => [Math.max(low[k], -0.5), Math.min(high[k], scene.size[k] - 0.5)]);
  const size = ends.map(([a, b]) => clamp(Math.round((b - a) / spacing), 1, LARGEST));
  return { first: ends.map(([a]) => a + spacing / 2), spacing, size };
}

// A canvas with the picture of `settings`, drawn in tiles.
export function drawFull(viewer, settings, { first, spacing, size: [width, height] }) {
  const sides = settings.stereo === "side" ? eyes(settings, viewer.scene.radius) : [settings];
  const sheet = Object.assign(document.createElement("canvas"), { width: width * sides.length, height }), paper = sheet.getContext("2d");
  sides.forEach((side, n) => {
    for (let v = 0; v < height; v += TILE) {
      for (let u = 0; u < width; u += TILE) {
        const w = Math.min(TILE, width - u), h = Math.min(TILE, height - v);
        const pixels = viewer.pixels(w, h, [first[0] + u * spacing, first[1] + v * spacing], spacing, side);
        paper.putImageData(new ImageData(pixels, w, h), n * width + u, v);
      }
    }
  });
  return sheet;
}

// Title and settings as the name of a file.
export function fileName({ scene, settings: s }, suffix) {
  const M = n => `M${(scene.pitch / Math.abs(n)).toFixed(2)}`, title = scene.title.replace(/\.[^.]*$/, "") || "view";
  const shown = {
    focus: `focus-${M(s.plane)}-${modeName(s.plane)}`, range: "sharp-range", sharp: "sharp", traditional: "traditional", tiles: `tiles-${M(s.plane)}-${modeName(s.plane)}`,
  }[s.mode];
  const aside = s.q.some(n => n) ? `_view${s.q.map(n => `${n < 0 ? "-" : "+"}${Math.abs(Math.round((100 * n) / scene.radius))}`).join("")}` : "";
  return `${title}_${shown}${aside}${s.stereo ? `_${s.stereo}` : ""}${s.overlay ? "_depth" : ""}${suffix}`;
}

export function savePicture(viewer) {
  const sheet = drawFull(viewer, viewer.settings, fullFrame(viewer));
  sheet.toBlob(blob => download(blob, fileName(viewer, ".png")));
}

// The best film that the browser can record, or undefined.
export function filmType() {
  return globalThis.MediaRecorder && ["video/webm;codecs=vp9", "video/webm", "video/mp4"].find(type => MediaRecorder.isTypeSupported(type));
}

// Settings of the pictures of a film: once around the main lens, or from far to near and back.
export function filmSettings({ scene, settings }, kind) {
  const steps = [...Array(PICTURES).keys()].map(n => (2 * Math.PI * n) / PICTURES), [low, high] = scene.planes;
  if (kind === "round") return steps.map(a => ({ ...settings, stereo: "", q: [0.6 * scene.radius * Math.cos(a), 0.6 * scene.radius * Math.sin(a)] }));
  return steps.map(a => {
    const near = low + (high - low) * (0.5 - 0.5 * Math.cos(a));
    return { ...settings, mode: "focus", stereo: "", plane: near < scene.pitch ? near : near - 2 * scene.pitch };
  });
}

// Draws all pictures, then plays them at their rate while they are recorded; `progress(done, all)` after each drawing.
export async function saveFilm(viewer, kind, progress) {
  const type = filmType(), full = fullFrame(viewer), factor = Math.max(...full.size, FILM_SIDE) / FILM_SIDE;
  const size = full.size.map(n => 2 * Math.max(1, Math.floor(n / factor / 2)));
  const frame = { size, spacing: full.spacing * factor, first: full.first.map(n => n + (full.spacing * (factor - 1)) / 2) };
  const all = filmSettings(viewer, kind), pictures = [];
  for (const settings of all) {
    pictures.push(await createImageBitmap(drawFull(viewer, settings, frame)));
    progress(pictures.length, all.length);
    await new Promise(resolve => setTimeout(resolve));
  }
  const sheet = Object.assign(document.createElement("canvas"), { width: size[0], height: size[1] }), paper = sheet.getContext("2d");
  const stream = sheet.captureStream(), recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: 12e6 }), parts = [];
  recorder.ondataavailable = event => parts.push(event.data);
  const ended = new Promise(resolve => (recorder.onstop = resolve));
  paper.drawImage(pictures[0], 0, 0);
  recorder.start();
  for (const picture of pictures) {
    paper.drawImage(picture, 0, 0);
    await new Promise(resolve => setTimeout(resolve, 1000 / RATE));
    picture.close();
  }
  recorder.stop();
  await ended;
  download(new Blob(parts, { type }), fileName(viewer, `_${kind}.${type.includes("mp4") ? "mp4" : "webm"}`));
}

function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
