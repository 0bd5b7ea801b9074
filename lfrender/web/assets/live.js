"use strict";
// The live page: asks for the picture after the one it shows, for the status twice a second, and sends commands.
const find = (id) => document.getElementById(id);
const picture = find("picture");
const token = new URLSearchParams(location.search).get("token") ?? "";
const past = [];
let kind = "sharp", place = [0.5, 0.5], shown = 0, pictures = 0, waiting = new AbortController();

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const address = (path, values = {}) => `${path}?${new URLSearchParams({ ...values, token })}`;

function say(text) { find("status").textContent = text; }

async function nextPicture() {
  const [x, y] = place.map((share) => share.toFixed(4));
  const values = { kind, after: shown, x, y };
  const response = await fetch(address("frame", values), { signal: waiting.signal });
  if (response.status === 200) {
    const url = URL.createObjectURL(await response.blob());
    const before = picture.src;
    picture.src = url;
    await picture.decode();
    if (before.startsWith("blob:")) URL.revokeObjectURL(before);
    pictures += 1;
    shown = Number(response.headers.get("X-Frame"));
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
  shown = 0;
  waiting.abort();
  waiting = new AbortController();
  document.querySelector(`input[value=${kind}]`).checked = true;
  picture.className = kind === "raw" ? "" : "focus";
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
  if (kind === "raw") return;
  // The picture lies in the middle of its element, as large as fits.
  const box = picture.getBoundingClientRect(), width = picture.naturalWidth, height = picture.naturalHeight;
  const scale = Math.min(box.width / width, box.height / height);
  const at = [(event.clientX - box.left - (box.width - scale * width) / 2) / (scale * width),
    (event.clientY - box.top - (box.height - scale * height) / 2) / (scale * height)];
  if (at.some((share) => share < 0 || share > 1)) return;
  place = at;
  choose("focus");
});
choose(kind);
showPictures();
showStatuses();
