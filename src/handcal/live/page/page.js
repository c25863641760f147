// Sends what the phone's sensors read, in numbered batches; keeps each until it is acknowledged.
"use strict";

const EVERY_MS = 250, LONGEST = 600, PATIENCE_MS = 8000, POLL_MS = 700, QUIET_MS = 1500;
const $ = (id) => document.getElementById(id);
const client = own();
const agent = /iPhone|iPad|iPod/.test(navigator.userAgent) ? "ios"
  : /Android/.test(navigator.userAgent) ? "android" : "other";

let next = 0;          // number of the next batch
let batch = empty();   // being filled
let unsent = [];       // filled, not acknowledged
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

function moved(event) {
  const w = event.rotationRate, a = event.accelerationIncludingGravity;
  const read = w && a ? [w.alpha, w.beta, w.gamma, a.x, a.y, a.z] : [];
  if (read.length !== 6 || !read.every(Number.isFinite)) return;
  const t = performance.timeOrigin + event.timeStamp;
  if (!(t > last)) return;
  last = t;
  batch.t.push(t);
  batch.gyro.push(read.slice(0, 3));
  batch.accel.push(read.slice(3));
}

function close() {
  while (batch.t.length) {
    const cut = (list) => list.splice(0, LONGEST);
    unsent.push({ client, seq: next++, agent, t: cut(batch.t), gyro: cut(batch.gyro), accel: cut(batch.accel) });
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

function show(said) {
  heard = performance.now();
  $("seconds").textContent = `${said.seconds.toFixed(0)} s`;
  $("rate").textContent = said.rate_hz ? `${said.rate_hz.toFixed(0)} Hz` : "–";
  if (said.turn) { $("say").textContent = said.turn.say; $("done").value = said.turn.done; $("turn").hidden = stopping; }
  if (said.biases) { $("closing").hidden = false; $("biases").replaceChildren(...said.biases.map(row)); }
  if (said.state === "working") {
    $("note").textContent = said.stage ? `Explaining: ${said.stage}` : "Explaining what was recorded";
    $("turn").hidden = false; $("say").textContent = "The result takes a minute or so.";
    $("done").value = said.progress || 0;
  }
  if (said.verdict) ended(said);
}

function row(b) {
  const cells = [b.name, `${b.value.toPrecision(2)} ± ${b.sigma.toPrecision(1)} ${b.unit}`].map((text) => {
    const cell = document.createElement("td"); cell.textContent = text; return cell;
  });
  const bar = document.createElement("meter"), cell = document.createElement("td"), line = document.createElement("tr");
  bar.max = 1; bar.value = Math.min(1, b.sigma / b.prior);
  cell.append(bar); line.append(...cells, cell);
  return line;
}

function ended(said) {
  $("headline").textContent = said.verdict.headline;
  $("sentences").replaceChildren(...said.verdict.sentences.map((text) => {
    const p = document.createElement("p"); p.textContent = text; return p;
  }));
  $("files").textContent = said.verdict.files.length ? `On the computer: ${said.verdict.files.join(", ")}` : "";
  $("verdict").className = said.state === "failed" ? "poor" : "";
  $("note").textContent = "It has ended; this page can be closed.";
  $("verdict").hidden = false;
  $("turn").hidden = $("buttons").hidden = true;
}

async function start() {
  $("start").disabled = true;
  try {
    if (typeof DeviceMotionEvent === "undefined") throw new Error("This browser does not give a page the sensors.");
    if (typeof DeviceMotionEvent.requestPermission === "function"
        && await DeviceMotionEvent.requestPermission() !== "granted") throw new Error("The sensors were not allowed.");
    const [status, said] = await post("hello", { client });
    if (status !== 200) throw new Error(said.error);
    next = said.next;
    complain("");
    show(said);
  } catch (error) { complain(error.message); $("start").disabled = false; return; }
  addEventListener("devicemotion", moved);
  if (navigator.wakeLock) navigator.wakeLock.request("screen").catch(() => {});
  $("start").hidden = true; $("stop").hidden = $("facts").hidden = false;
  $("note").textContent = "Recording. Keep this page open and the phone in its place.";
  setInterval(() => { if (!stopping) { close(); send(); } }, EVERY_MS);
  setTimeout(() => { if (last === -Infinity) complain("No readings arrive: this device has no gyro, or the page may not read it."); }, 2000);
}

async function stop() {
  stopping = true;
  $("stop").disabled = true;
  removeEventListener("devicemotion", moved);
  close();
  for (let tries = 0; unsent.length && tries < 20; tries++) {
    await send();
    if (unsent.length) await new Promise((ok) => setTimeout(ok, POLL_MS));
  }
  try { const [, said] = await post("stop", { client }); show(said); }
  catch { complain("No connection: press Stop again."); $("stop").disabled = stopping = false; return; }
  $("stop").hidden = true;
  poll();
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

$("start").addEventListener("click", start);
$("stop").addEventListener("click", stop);
