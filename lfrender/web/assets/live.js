// The live page: asks for the picture after the one it shows, for the status twice a second, and sends commands.

import { depthOrder, patchSize } from "lfrender/geometry";
import { describePlace, describePlane } from "lfrender/readout";

const find = (id) => document.getElementById(id);
const picture = find("picture");
const token = new URLSearchParams(location.search).get("token") ?? "";
const past = [];
// In focus is a plane [px], or else a place, as shares of width and height. `choice` counts the pictures that were chosen.
let kind = "sharp", place = [0.5, 0.5], plane, choice = 0, pitch = 0;
let shown = 0, asked = 0, pictures = 0, waiting = new AbortController();

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const address = (path, values = {}) => `${path}?${new URLSearchParams({ ...values, token })}`;

const asValues = (at) => ({ x: at[0].toFixed(4), y: at[1].toFixed(4) });

function say(text) { find("status").textContent = text; }

async function nextPicture() {
  const mine = choice, focus = plane === undefined ? asValues(place) : { plane };
  asked = shown;
  const values = { kind, after: shown, ...focus };
  const response = await fetch(address("frame", values), { signal: waiting.signal });
  if (response.status === 200) {
    const url = URL.createObjectURL(await response.blob());
    const before = picture.src;
    picture.src = url;
    await picture.decode();
    if (before.startsWith("blob:")) URL.revokeObjectURL(before);
    pictures += 1;
    const drawn = Number(response.headers.get("X-Plane"));
    if (drawn && plane === undefined) showPlane(drawn);
    shown = mine === choice ? Number(response.headers.get("X-Frame")) : 0;
  } else if (response.status !== 204) {
    find("saved").textContent = (await response.json()).message;
    await pause(500);
  }
}

async function showPictures() {
  for (;;) {
    try { await nextPicture(); } catch (error) {
      // Another picture was chosen, or the program has ended, which the status says.
      if (error.name !== "AbortError") await pause(500);
    }
  }
}

function choose(next) {
  kind = next;
  choice += 1;
  // A picture that is drawn is shown; waiting for a later frame ends.
  if (asked) {
    waiting.abort();
    waiting = new AbortController();
  }
  shown = 0;
  document.querySelector(`input[value=${kind}]`).checked = true;
  picture.className = kind === "raw" ? "" : "focus";
}

function showPlane(s) {
  if (!pitch) return;
  find("plane").value = depthOrder(s, pitch);
  find("plane-value").textContent = describePlane(s, pitch, true);
}

function showPlanes({ planes }) {
  const slider = find("plane");
  slider.disabled = !planes;
  if (!planes) return;
  if (pitch !== planes.pitch) plane = undefined;
  pitch = planes.pitch;
  [slider.min, slider.max] = [planes.far, planes.near];
}

// The place of a pointer in the picture, which lies in the middle of its element, as large as fits.
function placeOf(event) {
  const box = picture.getBoundingClientRect(), width = picture.naturalWidth, height = picture.naturalHeight;
  const scale = Math.min(box.width / width, box.height / height);
  const at = [(event.clientX - box.left - (box.width - scale * width) / 2) / (scale * width),
    (event.clientY - box.top - (box.height - scale * height) / 2) / (scale * height)];
  return at.every((share) => share >= 0 && share <= 1) ? at : undefined;
}

let under, reading = false;

// The depth under the pointer; of places that it passes meanwhile, the last one.
async function readDepth() {
  if (reading) return;
  reading = true;
  let at;
  do {
    at = under;
    let words = "";
    try {
      const response = at && (await fetch(address("depth", asValues(at))));
      if (response?.status === 200) {
        const { patch_size: s, confidence: sure, distance } = await response.json();
        words = describePlace({ s, sure, position: distance === null ? undefined : [0, 0, distance] }, { pitch });
      }
    } catch { /* The status says that the program has ended. */ }
    find("readout").textContent = words;
  } while (at !== under);
  reading = false;
}

function readAt(event) {
  under = event && placeOf(event);
  readDepth();
}

let sharpest = 0;

function showLight({ histogram, clipped, sharpness }) {
  // Roots, so that few bright pixels are seen beside many dark ones.
  const most = Math.sqrt(Math.max(...histogram, 1));
  const bars = histogram.map((n, k) => `M${k} 10h1v-${((10 * Math.sqrt(n)) / most).toFixed(2)}h-1z`);
  document.querySelector("#histogram path").setAttribute("d", bars.join(""));
  find("clipped").textContent = `${(100 * clipped).toFixed(clipped > 0 && clipped < 0.01 ? 2 : 0)} %`;
  sharpest = Math.max(sharpest, sharpness);
  find("sharpness").textContent = `${((100 * sharpness) / sharpest).toFixed(0)} % of the best so far`;
}

function showStatus(status) {
  // Rates are those of the last few seconds.
  past.push({ ...status, pictures, time: performance.now() });
  if (past.length > 7) past.shift();
  const first = past[0], last = past[past.length - 1], seconds = Math.max((last.time - first.time) / 1000, 0.1);
  const rate = (name) => `${last[name].toLocaleString("en")}, ${((last[name] - first[name]) / seconds).toFixed(1)} / s`;
  const [about, ...told] = status.camera.split("\n");
  find("about").textContent = about;
  find("told").textContent = told.join("\n\n");
  find("received").textContent = rate("received");
  find("shown").textContent = rate("pictures");
  find("lost").textContent = status.lost.toLocaleString("en");
  find("latency").textContent = `${(1000 * status.latency).toFixed(0)} ms`;
  find("still").textContent = `${(100 * status.still).toFixed(0)} % as before`;
  if (status.histogram) showLight(status);
  showPlanes(status);
  const recording = status.recording, button = find("record");
  button.dataset.command = recording ? "stop" : "record";
  button.textContent = recording ? "Stop recording" : "Record raw frames";
  button.classList.toggle("on", Boolean(recording));
  find("saved").textContent = recording ?? status.saved;
  say(status.message);
}

async function showStatuses() {
  for (;;) {
    try { showStatus(await (await fetch(address("status"))).json()); } catch { say("lfrender live has ended, or is out of reach"); }
    await pause(500);
  }
}

async function send(command) {
  try {
    const answer = await fetch(address(command), { method: "POST", headers: { "X-Lfrender": "1" } });
    const status = await answer.json();
    if (answer.ok) showStatus(status); else find("saved").textContent = status.message;
  } catch { say("lfrender live has ended, or is out of reach"); }
}

for (const input of document.querySelectorAll("input[name=kind]")) input.addEventListener("change", () => choose(input.value));
for (const button of document.querySelectorAll("[data-command]")) button.addEventListener("click", () => send(button.dataset.command));
find("whole").addEventListener("change", (event) => find("stage").classList.toggle("whole", event.target.checked));
picture.addEventListener("click", (event) => {
  const at = placeOf(event);
  if (kind === "raw" || !at) return;
  place = at;
  plane = undefined;
  choose("focus");
});
for (const name of ["pointermove", "pointerdown"]) picture.addEventListener(name, readAt);
picture.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && readAt());
find("plane").addEventListener("input", (event) => {
  plane = patchSize(Number(event.target.value), pitch);
  showPlane(plane);
  choose("focus");
});
choose(kind);
showPictures();
showStatuses();
