// The settings of a page in its address, after the #: a link shows the same view.

const number = n => String(Number(n.toPrecision(6)));
const numbers = text => text.split(",").map(Number);
const MODES = ["focus", "range", "sharp", "tiles"];

export function writeAddress({ settings: s, frame, fitted }) {
  const parts = { mode: s.mode, s: number(s.plane) };
  if (s.mode === "range") parts.range = s.range.map(number).join(",");
  if (s.aperture < 1) parts.aperture = number(s.aperture);
  if (s.q.some(n => n)) parts.q = s.q.map(number).join(",");
  if (s.overlay) parts.overlay = number(s.overlay);
  if (s.brightness) parts.brightness = number(s.brightness);
  if (s.stereo) parts.stereo = s.stereo;
  if (!fitted) parts.view = [...frame.middle, frame.spacing].map(number).join(",");
  return Object.entries(parts).map(([name, value]) => `${name}=${value}`).join("&");
}

// Settings and the part of the scene in view, of an address; what makes no sense is left out.
export function readAddress(text) {
  const parts = new URLSearchParams(text), settings = {};
  const take = (name, count, put) => {
    const found = numbers(parts.get(name) ?? "x");
    if (found.length === count && found.every(Number.isFinite)) put(count > 1 ? found : found[0]);
  };
  if (MODES.includes(parts.get("mode"))) settings.mode = parts.get("mode");
  take("s", 1, n => n && (settings.plane = n));
  take("range", 2, n => (settings.range = n));
  take("aperture", 1, n => (settings.aperture = Math.min(Math.max(n, 0.05), 1)));
  take("q", 2, n => (settings.q = n));
  take("overlay", 1, n => (settings.overlay = Math.min(Math.max(n, 0), 1)));
  take("brightness", 1, n => (settings.brightness = Math.min(Math.max(n, -3), 3)));
  if (["anaglyph", "side"].includes(parts.get("stereo"))) settings.stereo = parts.get("stereo");
  let view;
  take("view", 3, n => n[2] > 0 && (view = n));
  return { settings, view };
}
