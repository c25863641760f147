// Sends what the phone's sensors read, in numbered batches; keeps each until it is acknowledged.
"use strict";

const FASTEST_HZ = 400, GAP_MS = 500, SILENT_MS = 1500;
const EVERY_MS = 100, LONGEST = 600, PATIENCE_MS = 8000, POLL_MS = 700, QUIET_MS = 1500, WATCH_MS = 2000;
const $ = (id) => document.getElementById(id);
const client = own();
const agent = /iPhone|iPad|iPod/.test(navigator.userAgent) ? "ios"
  : /Android/.test(navigator.userAgent) ? "android" : "other";

let next = 0;          // number of the next batch
let batch = empty();   // being filled
let unsent = [];       // filled, not acknowledged
let watching = false;  // readings come from elsewhere
let sending = false, stopping = false, last = -Infinity, heard = 0;

function own() {
  const kept = sessionStorage.getItem("client");
  if (kept) return kept;
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  const made = Array.from(bytes, (b) => b.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem("client", made);
  return made;
}

function empty() { return { t: [], gyro: [], accel: [] }; }

async function post(name, body) {
  const control = new AbortController();
  const timer = setTimeout(() => control.abort(), PATIENCE_MS);
  try {
    const answer = await fetch(name, { method: "POST", body: JSON.stringify(body), signal: control.signal });
    return [answer.status, await answer.json()];
  } finally { clearTimeout(timer); }
}

function complain(text) { $("error").textContent = text; $("error").hidden = !text; }

// Readings come by DeviceMotion events (deg/s), which every browser on a phone has, or by the sensors'
// own interface (the Generic Sensor API, rad/s), where each reading has its own stamp.
let api = "motion";

function moved(event) {
  const w = event.rotationRate, a = event.accelerationIncludingGravity;
  if (w && a) read(performance.timeOrigin + event.timeStamp, [w.alpha, w.beta, w.gamma], [a.x, a.y, a.z]);
}

function read(t, gyro, accel) {
  if (![...gyro, ...accel].every(Number.isFinite) || !(t > last)) return;
  last = t;
  batch.t.push(t); batch.gyro.push(gyro); batch.accel.push(accel);
}

const sensors = [];  // of the Generic Sensor API, while they are read
let rates = [], forces = [], spoke = -Infinity;

// Rates wait for the force after them, which is then taken at their stamp; across a gap there is none.
function paired() {
  while (rates.length && forces.length && forces[forces.length - 1].t >= rates[0].t) {
    const { t, x } = rates.shift();
    while (forces.length > 1 && forces[1].t <= t) forces.shift();
    const [before, after] = forces;
    if (before.t === t) read(t, x, before.x);
    else if (before.t < t && after.t - before.t < GAP_MS) {
      const u = (t - before.t) / (after.t - before.t);
      read(t, x, before.x.map((f, i) => f + u * (after.x[i] - f)));
    }
    spoke = performance.now();
  }
  rates = rates.slice(-LONGEST); forces = forces.slice(-LONGEST);
}

async function allowed(name) {
  try { return (await navigator.permissions.query({ name })).state !== "denied"; } catch { return true; }
}

// Whether the sensors' own interface gives readings here; else it is left alone.
async function direct() {
  if (typeof Gyroscope === "undefined" || typeof Accelerometer === "undefined") return false;
  if (!await allowed("gyroscope") || !await allowed("accelerometer")) return false;
  let refused = false;
  try {
    for (const [Kind, list] of [[Gyroscope, () => rates], [Accelerometer, () => forces]]) {
      const sensor = new Kind({ frequency: FASTEST_HZ });
      sensor.addEventListener("reading", () => {
        list().push({ t: performance.timeOrigin + sensor.timestamp, x: [sensor.x, sensor.y, sensor.z] });
        paired();
      });
      sensor.addEventListener("error", () => { refused = true; });
      sensors.push(sensor);
      sensor.start();
    }
  } catch { refused = true; }
  const began = performance.now();
  while (!refused && spoke < began && performance.now() - began < SILENT_MS) await new Promise((ok) => setTimeout(ok, 20));
  if (refused || spoke < began) { undirect(); batch = empty(); last = -Infinity; return false; }
  return true;
}

function undirect() { sensors.splice(0).forEach((s) => s.stop()); rates = []; forces = []; }

// Sensors that fall silent in the middle (some speak only of changes) are given up for motion events.
function watchdog() {
  if (api === "sensor" && performance.now() - spoke > SILENT_MS) { close(); undirect(); byMotion(); }
}

function byMotion() { api = "motion"; addEventListener("devicemotion", moved); }

function close() {
  while (batch.t.length) {
    const cut = (list) => list.splice(0, LONGEST);
    unsent.push({ client, seq: next++, agent, api, t: cut(batch.t), gyro: cut(batch.gyro), accel: cut(batch.accel) });
  }
  $("waiting").textContent = unsent.length;
}

async function send() {
  if (sending) return;
  if (!unsent.length && performance.now() - heard > QUIET_MS) return ask();
  sending = true;
  try {
    while (unsent.length) {
      const [status, said] = await post("batch", unsent[0]);
      if (status === 403) { complain(said.error); break; }
      if (said.next > unsent[0].seq) { unsent.shift(); complain(""); show(said); continue; }
      if (status === 400 || status === 413) {  // never to be taken: its number goes to the next one
        unsent.shift(); unsent.forEach((b) => { b.seq -= 1; }); next -= 1;
      }
      complain(said.error || "");
      break;  // again in a moment
    }
  } catch { complain("No connection; what was read is kept and sent again."); }
  finally { sending = false; $("waiting").textContent = unsent.length; }
}

async function ask() {  // nothing to send: what is new there, and that this page still is
  sending = true;
  try { const [status, said] = await post("hello", { client }); if (status === 200) { complain(""); show(said); } }
  catch { complain("No connection; what is read is kept and sent later."); }
  finally { sending = false; }
}

function text(id, words) { $(id).textContent = words || ""; $(id).hidden = !words; }

function show(said) {
  heard = performance.now();
  $("seconds").textContent = `${said.seconds.toFixed(0)} s`;
  $("rate").textContent = said.rate_hz ? `${said.rate_hz.toFixed(0)} Hz` : "–";
  if (watching) { $("waitname").textContent = "late"; $("waiting").textContent = said.late; }
  if (said.turn) {
    $("say").textContent = said.turn.say; $("done").value = said.turn.done; $("turn").hidden = stopping;
    text("hint", said.turn.hint); text("brought", said.brought);
    $("turn").dataset.name = said.turn.name || "";
    picture = said.turn.picture || null; $("asked").hidden = !picture; $("stage").hidden = !picture && !held;
  }
  if (said.filter) known(said.filter);
  else { held = null; $("own").hidden = true; text("checks", ""); }
  text("doubts", (said.doubts || []).join(" "));
  if (said.parameters) { $("closing").hidden = false; $("bars").replaceChildren(...said.parameters.map(row)); }
  if (said.so_far && said.so_far.length) text("sofar", `The readings so far are best explained by: ${said.so_far.join("; ")}.`);
  if (said.state === "working") {
    $("note").textContent = said.stage ? `Explaining: ${said.stage}` : "Explaining what was recorded";
    $("turn").hidden = false; $("stage").hidden = true; picture = null; held = null;
    $("say").textContent = "The result takes a minute or so."; text("hint", ""); text("doubts", "");
    $("done").value = said.progress || 0;
  }
  if (said.verdict) ended(said);
}

// What the filter says, which takes each sample as it comes: how the phone is held, and whether what
// it reads is what is expected.
let held = null;

function known(filter) {
  held = filter.held;
  $("own").hidden = false; $("stage").hidden = stopping;
  $("held").style.transform = placed(held);
  text("checks", filter.innovations.map((one) => `Does it fit: ${one.name}, ${one.times.toFixed(1)} times as far off as `
    + `expected, ${one.beyond} of ${one.of} beyond ${one.gate} sigma.`).join(" "));
}

function row(b) {
  const line = document.createElement("tr");
  line.className = b.good ? "good" : "";
  for (const words of [b.name, b.text]) {
    const cell = document.createElement("td"); cell.textContent = words; line.append(cell);
  }
  const bar = document.createElement("meter"), cell = document.createElement("td");
  bar.max = 1; bar.value = b.left;
  cell.append(bar); line.append(cell);
  return line;
}

// The phone that shows what to do: body axes are x right, y to the top, z out of the screen; the
// floor's are the page's, where y points down.
let picture = null, shownSince = 0, shownTurn = "";

function times(a, b) {
  return [0, 1, 2].flatMap((i) => [0, 1, 2].map((j) => a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j]));
}

function about([x, y, z], angle) {
  const n = Math.hypot(x, y, z), c = Math.cos(angle), s = Math.sin(angle), v = 1 - c;
  [x, y, z] = [x / n, y / n, z / n];
  return [c + x * x * v, x * y * v - z * s, x * z * v + y * s, y * x * v + z * s, c + y * y * v, y * z * v - x * s,
    z * x * v - y * s, z * y * v + x * s, c + z * z * v];
}

function draw(now) {
  if (picture) {
    const turn = JSON.stringify(picture);
    if (turn !== shownTurn) { shownTurn = turn; shownSince = now; }
    const t = ((now - shownSince) / 1000) % (picture.seconds + 1), s = Math.min(1, t / picture.seconds);
    const m = times(picture.from, about(picture.axis, picture.degrees * Math.PI / 180 * s * s * (3 - 2 * s)));
    $("phone").style.transform = placed(m);
  }
  requestAnimationFrame(draw);
}

function placed(m) {
  const flip = [1, -1, 1], at = (i, j) => m[3 * i + j] * flip[i] * flip[j];
  const cells = [0, 1, 2].flatMap((j) => [...[0, 1, 2].map((i) => at(i, j).toFixed(5)), 0]);
  return `matrix3d(${cells.join(",")},0,0,0,1)`;
}
requestAnimationFrame(draw);

function ended(said) {
  $("headline").textContent = said.verdict.headline;
  $("sentences").replaceChildren(...said.verdict.sentences.map((text) => {
    const p = document.createElement("p"); p.textContent = text; return p;
  }));
  for (const text of said.verdict.warnings || []) {
    const p = document.createElement("p"); p.className = "warning"; p.textContent = text; $("sentences").append(p);
  }
  $("files").textContent = said.verdict.files.length ? `On the computer: ${said.verdict.files.join(", ")}` : "";
  $("verdict").className = said.state === "failed" ? "poor" : "";
  $("note").textContent = "It has ended; this page can be closed.";
  $("verdict").hidden = false;
  $("turn").hidden = $("buttons").hidden = true;
}

async function start() {
  $("start").disabled = true;
  try {
    if (await direct()) api = "sensor";
    else if (typeof DeviceMotionEvent === "undefined") throw new Error("This browser does not give a page the sensors.");
    else if (typeof DeviceMotionEvent.requestPermission === "function"
        && await DeviceMotionEvent.requestPermission() !== "granted") throw new Error("The sensors were not allowed.");
    const [status, said] = await post("hello", { client });
    if (status !== 200) throw new Error(said.error);
    next = said.next;
    complain("");
    show(said);
  } catch (error) { undirect(); complain(error.message); $("start").disabled = false; return; }
  if (api === "motion") byMotion();
  if (navigator.wakeLock) navigator.wakeLock.request("screen").catch(() => {});
  $("start").hidden = true; $("stop").hidden = $("facts").hidden = false;
  $("note").textContent = "Recording. Keep this page open and the phone in its place.";
  setInterval(() => { if (!stopping) { watchdog(); close(); send(); } }, EVERY_MS);
  setTimeout(() => { if (last === -Infinity) complain("No readings arrive: this device has no gyro, or the page may not read it."); }, 2000);
}

async function begin() {  // readings come from an app, a recorder or a phone that is asked: watch
  try {
    const said = await (await fetch("state")).json();
    if ($("start").hidden || $("start").disabled) return;
    if (said.source === "page" && !said.verdict) { setTimeout(begin, WATCH_MS); return; }
    watching = true;
    $("start").hidden = true; $("facts").hidden = false; $("stop").hidden = said.state !== "recording";
    $("note").textContent = "Readings come from elsewhere; this page shows what to do.";
    show(said);
    if (!said.verdict) poll();
  } catch { complain("No connection to the computer."); }
}

async function stop() {
  stopping = true;
  $("stop").disabled = true;
  removeEventListener("devicemotion", moved);
  undirect();
  close();
  for (let tries = 0; unsent.length && tries < 20; tries++) {
    await send();
    if (unsent.length) await new Promise((ok) => setTimeout(ok, POLL_MS));
  }
  try { const [, said] = await post("stop", { client }); show(said); }
  catch { complain("No connection: press Stop again."); $("stop").disabled = stopping = false; return; }
  $("stop").hidden = true;
  if (!watching) poll();
}

async function poll() {
  try {
    const said = await (await fetch("state")).json();
    complain("");
    show(said);
    if (said.verdict) return;
  } catch { complain("No connection to the computer; its terminal says what became of it."); }
  setTimeout(poll, POLL_MS);
}

begin();
$("start").addEventListener("click", start);
$("stop").addEventListener("click", stop);
