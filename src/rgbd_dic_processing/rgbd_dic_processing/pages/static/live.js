// The page of a running graph.
import {post} from "./ask.js";
import {CameraView} from "./camera.js";
import {Chart} from "./chart.js";

const $ = (id) => document.getElementById(id);
const ORDER = ["crack", "compensation", "plane", "pairing", "dic", "recorder", "mavlink", "tof", "camera", "player"].reverse();
const MINUTE_S = 60, OLD_S = 2, LATE_S = 1.5, SILENT_S = 3.5;
const STATES = {ok: "running", warn: "warning", error: "error", silent: "silent"};
const LOST = /^(lost|dropped|missed|skipped|failed|incomplete|invalid|without)\b/;
const minute = new Chart($("minute")), flight = new Chart($("flight"));
const seen = {flight: -1, samples: [], events: [], overview: null, last: null, changedAt: 0, offers: {}, recording: null};

new CameraView($("picture"), $("picture-note"));

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live/numbers`);
  socket.onmessage = (event) => {
    socket.send("");  // it is here: the next may come
    take(JSON.parse(event.data));
  };
  socket.onopen = () => linked("connected", true);
  socket.onclose = async () => {
    linked(await refusal() || "connection lost, trying again…", false);
    setTimeout(connect, 1000);
  };
}

// Why the server does not let this page in, in its words; empty if it does, or is not there.
async function refusal() {
  try {
    const response = await fetch("/live/numbers");
    return [401, 403, 503].includes(response.status) ? response.text() : "";
  } catch {
    return "";
  }
}

function linked(words, well) {
  $("link").textContent = words;
  $("link").classList.toggle("lost", !well);
}

function take(content) {
  if (content.from_start || content.flight !== seen.flight) seen.samples = [];
  seen.flight = content.flight;
  seen.samples.push(...content.samples);
  const oldest = (seen.samples.at(-1)?.[0] ?? 0) - MINUTE_S;
  seen.samples = seen.samples.filter(([time]) => time >= oldest);
  if (content.last && content.last.stamp_ns !== seen.last?.stamp_ns) {
    seen.last = content.last;
    seen.changedAt = performance.now();
  }
  if (content.nodes) surroundings(content);
  reading();
  if (content.samples.length || content.nodes) minute.minute(seen.samples, seen.events);
}

function surroundings({nodes, offers, viewers, overview, events}) {
  Object.assign(seen, {events, offers, overview});
  linked(viewers > 1 ? `connected, ${viewers} viewers` : "connected", true);
  flight.flight(overview, events);
  const recorder = nodes.find((node) => node.counters.recording && node.heard < SILENT_S);
  seen.recording = recorder ? recorder.counters.recording === "on" : null;
  $("reference").disabled = !offers.reference;
  $("recording").disabled = !offers.recording || seen.recording === null;
  $("recording").textContent = seen.recording === false ? "Start recording" : "Stop recording";
  const wrong = nodes.map((node) => [node.name, stateOf(node)]).filter(([, state]) => state !== "ok");
  say($("health"), wrong.map(([name, state]) => `${name}: ${STATES[state]}`).join(", ") || `${nodes.length} nodes run`);
  $("health").className = wrong.length ? "lost" : "";
  const place = ({name}) => ORDER.findIndex((start) => name.startsWith(start));
  $("nodes").replaceChildren(...nodes.sort((a, b) => place(a) - place(b)).map(nodeRow));
}

function reading() {
  const {last} = seen, age = (performance.now() - seen.changedAt) / 1000, old = last && age > OLD_S;
  const opening = $("opening"), shown = last?.valid && !old;
  $("value").textContent = last?.valid ? signed(last.opening_mm, 3) : "–––";
  opening.classList.toggle("none", !shown);
  opening.dataset.stamp = last?.stamp_ns ?? "";
  opening.dataset.value = last?.opening_mm ?? "";
  $("method").textContent = last ? `(${last.method})` : "";
  $("uncertainty").textContent = last?.valid ? `± ${last.u_mm.toFixed(3)} mm (k = 1)` : "";
  $("uncertainty").dataset.value = last?.u_mm ?? "";
  const state = $("state");
  state.className = `state ${!last || old ? "old" : last.valid ? "valid" : "invalid"}`;
  say(state, !last ? "waiting for the first measurement" : old ? "no new measurement" : last.valid ? "valid" : "not valid");
  $("reason").textContent = last && !last.valid ? last.reason : old ? `the last one is ${age.toFixed(0)} s old` : "";
  if (!last) return;
  const valid = seen.samples.map(([, value]) => value !== null);
  rows($("facts"), [
    ["Valid in the last minute", valid.length ? `${(100 * valid.filter(Boolean).length / valid.length).toFixed(1)} %` : "–"],
    ["Image of", `${last.clock.split(" ")[1]} UTC`],
    ["Sliding", last.sliding_mm === null ? "–" : `${signed(last.sliding_mm, 3)} mm`],
    ["Reference taken", last.reference_age_s === null ? "not yet" : `${last.reference_age_s.toFixed(1)} s before`],
    ["Subsets left, right", `${last.left}, ${last.right}`],
    ["Latency", last.latency_s === null ? "–" : latency(last.latency_s)],
    ["Image to depth", last.depth_offset_s === null ? "–" : `${(last.depth_offset_s * 1000).toFixed(1)} ms`],
  ]);
}

const stateOf = ({heard, level}) => (heard > SILENT_S ? "silent" : level);

function nodeRow(node) {
  const {name, message, counters, topics, heard} = node, state = stateOf(node), row = document.createElement("tr");
  const main = topics.reduce((a, b) => ((b.rate ?? -1) > (a?.rate ?? -1) ? b : a), null);
  const cells = [
    STATES[state],
    main?.rate?.toFixed(1) ?? "–",
    main?.age?.toFixed(2) ?? "–",
    lost(counters),
    state === "silent" ? `not heard for ${heard.toFixed(0)} s` : message === "OK" ? disk(counters) : message,
  ];
  const head = document.createElement("th");
  head.scope = "row";
  head.textContent = name;
  row.className = state;
  row.append(head, ...cells.map((text, i) => {
    const cell = document.createElement("td");
    cell.textContent = text;
    if (i > 0 && i < 3) cell.className = "n";
    return cell;
  }));
  return row;
}

// What was lost, by kind: the recorder counts each topic by itself.
function lost(counters) {
  const sums = {};
  for (const [key, count] of Object.entries(counters)) {
    const kind = key.split(" /")[0];
    if (LOST.test(kind) && Number(count)) sums[kind] = (sums[kind] || 0) + Number(count);
  }
  return Object.entries(sums).map(([kind, count]) => `${count} ${kind}`).join(", ") || "0";
}

function disk(counters) {
  const rate = counters["rate [MB/s]"], left = Number(counters["time left [s]"]);
  return rate === undefined ? "" : `${rate} MB/s${left > 0 ? `, room for ${(left / 60).toFixed(0)} min` : ""}`;
}

const latency = (value) => `${(value * 1000).toFixed(0)} ms${value > LATE_S ? ", late" : ""}`;

const signed = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;

function say(element, words) {
  if (element.textContent !== words) element.textContent = words;  // so that it is read out only once
}

function rows(list, pairs) {
  if (list.children.length !== 2 * pairs.length)
    list.replaceChildren(...pairs.flatMap(() => [document.createElement("dt"), document.createElement("dd")]));
  pairs.flat().forEach((text, i) => say(list.children[i], text));
}

async function ask(path, content) {
  try {
    $("said").classList.remove("wrong");
    $("said").textContent = (await post(path, content)).done;
  } catch (error) {
    $("said").textContent = error.message;
    $("said").classList.add("wrong");
  }
}

$("reference").onclick = () => ask("/live/reference", {});
$("recording").onclick = () => ask("/live/recording", {on: seen.recording === false});
$("mark").onsubmit = async (event) => {
  event.preventDefault();
  await ask("/live/event", {text: $("event").value});
  $("event").value = "";
};
setInterval(reading, 500);
connect();
