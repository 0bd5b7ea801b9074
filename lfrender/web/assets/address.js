// The settings of a page in its address, after the #: a link shows the same view.

const number = n => String(Number(n.toPrecision(6)));
const numbers = text => text.split(",").map(Number);
const MODES = ["focus", "range", "sharp", "tiles", "traditional"];

export function writeAddress({ settings: s, scene, frame, fitted }) {
  const parts = { mode: s.mode };
  // The depth that the page opens with is that of its flat.
  if (s.plane !== scene.plane) parts.s = number(s.plane);
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

// Buttons and keys that lead to the flats before and after this one, with the view as it is now.
export function controlFlats(viewer) {
  const go = id => {
    const link = document.getElementById(id);
    if (link?.hasAttribute("href")) location.href = `${link.getAttribute("href")}#${viewer() ? writeAddress(viewer()) : location.hash.slice(1)}`;
  };
  for (const id of ["previous", "next"]) {
    document.getElementById(id)?.addEventListener("click", event => {
      event.preventDefault();
      go(id);
    });
  }
  document.addEventListener("keydown", event => {
    const id = { p: "previous", n: "next" }[event.key.toLowerCase()];
    if (id && !event.ctrlKey && !event.metaKey && !event.altKey && event.target.tagName !== "SELECT") go(id);
  });
}
