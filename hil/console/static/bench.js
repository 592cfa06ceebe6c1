// The page: its line to the server, its views, its stop button.
import { ask, element, listing, replaceIfNew } from "./parts.js";
import { Scope } from "./scope.js";
import { dueStep, openForm, showForms, showSteps, updateSteps } from "./steps.js";
import { showState } from "./devices.js";
import { showFiles, ticked } from "./files.js";
import { buildRecorded, derivedTexts, lay } from "./recorded.js";
import { angles } from "./panes.js";
import { buildLive, doingOf, letGo, showLive } from "./live.js";

const at = (id) => document.getElementById(id);
const VIEWS = ["commission", "scope", "experiments", "state", "recordings"];
const scope = new Scope();
const bench = { client: "", described: null, state: null, speedOf: (axis) => scope.speedOf(axis) };
const worker = new Worker("/static/worker.js");
const HEARD_MS = 500;
const tellOfStop = []; // who waits to know whether the server has heard a stop

function show() {
  const view = VIEWS.includes(location.hash.slice(1)) ? location.hash.slice(1) : "commission";
  for (const name of VIEWS) at(name).hidden = name !== view;
  for (const tab of document.querySelectorAll("#tabs a")) {
    if (tab.hash === `#${view}`) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  window.scrollTo(0, 0); // not to the view's own beginning: the machine stands above it
  scope.visible(view === "scope");
  if (view === "recordings") showFiles(bench);
  if (bench.state) {
    showState(bench);
    showNext(bench);
    updateSteps(bench);
  }
}

async function stop() {
  at("stop").disabled = false;
  at("now").className = "asked";
  delete at("now-says").dataset.key; // whatever comes then is shown
  at("now-says").replaceChildren(element("span", { class: "what" }, "stop asked"));
  if (await heardOnTheLine()) return;
  try {
    await ask("/api/stop", {}, bench.client);
  } catch (error) {
    complain(`The stop did not reach the server (${error.message}): use the emergency stop, or isocenter stop in a terminal.`);
  }
}

// The line that keeps a motion going takes the stop as well, whatever a request of its own would be refused for.
function heardOnTheLine() {
  return new Promise((tell) => {
    tellOfStop.push(tell);
    setTimeout(tell, HEARD_MS, false);
    worker.postMessage("stop");
  });
}

// An error stays until it is dismissed.
function complain(text) {
  const button = element("button", { type: "button", "aria-label": "dismiss" }, "✕");
  const line = element("div", {}, element("span", {}, text), button);
  button.onclick = () => line.remove();
  for (const other of [...at("errors").children]) if (other.firstChild.textContent === text) other.remove();
  at("errors").append(line);
}

// What a run does now, what remains of it, and the share that is done; null where nobody knows it.
function progressOf(work, recording) {
  const { told, progress } = work;
  const counted = /(\d+) %/.exec(progress);
  if (told && told.doing !== "recording") return [doingOf(told, true), null];
  if (recording && recording.live && recording.began) {
    const done_s = recording.rows / bench.described.machine.rate_Hz;
    const all = told ? ` of ${told.remains_s.toFixed(0)} s` : " s";
    return [`recording ${recording.name}: ${recording.rows} rows, ${done_s.toFixed(0)}${all}`, told && told.remains_s ? done_s / told.remains_s : null];
  }
  return [progress || "begins ...", counted ? Number(counted[1]) / 100 : null];
}

// One event: what runs, or what came last, be it an end or a stop.
function showNow(state) {
  const { work, recording, live, stop } = state;
  const parts = [];
  let [kind, share] = [work.state, null];
  if (stop && !stop.ran) kind = "stopped";
  else if (work.state !== "running" && live.told && live.told.doing !== "watching" && (live.moves || work.state === "idle")) {
    kind = live.moves ? "running" : "idle";
    parts.push(element("span", { class: "what" }, doingOf(live.told)));
  } else if (work.state === "idle") parts.push(element("span", {}, "Nothing runs."));
  else {
    const words = { running: ": running", passed: ": done", bad: ":", failed: ": failed", stopped: ": stopped" }[work.state];
    parts.push(element("span", { class: "what" }, `${work.title}${words}`));
    if (work.state !== "bad") parts.push(element("span", {}, `${work.seconds.toFixed(0)} s`)); // which the verdict's own sentence follows
    if (work.state === "running") {
      const [says, done] = progressOf(work, recording);
      share = done;
      parts.push(element("span", { class: "grow" }, says));
      if (work.moves) {
        const whose = state.own ? "this page keeps it running: closing the page stops it" : "another browser started it";
        parts.push(element("span", { class: "dim" }, whose));
      }
    } else {
      parts.push(element("span", { class: "grow" }, work.why));
      for (const name of work.made.filter((each) => each.endsWith(".html"))) {
        parts.push(element("a", { href: `/files/${name}`, target: "_blank", rel: "noopener" }, `open ${name}`));
      }
    }
  }
  if (stop) {
    const { by, seconds, trouble, lines } = stop;
    const took = seconds === null ? "stopping ..." : trouble ? trouble : `${lines.join("; ")}, ${seconds.toFixed(2)} s after STOP`;
    parts.push(element("span", { class: trouble ? "bad" : "dim", title: by, id: "stop-answer" }, took));
    if (seconds === null) kind = "asked";
  }
  at("now").className = kind;
  replaceIfNew(at("now-says"), `${kind} ${parts.map((part) => part.outerHTML)}`, () => parts); // a link that is made anew under a click is not followed
  at("share").hidden = share === null;
  if (share !== null) at("share").value = share;
  at("release").hidden = !(live.holds || (work.state === "running" && work.holds));
}

// Where the way goes on from another view: the step that is due, or an experiment once all have passed. Nothing moves by it.
function showNext(bench) {
  const { state, described } = bench;
  const due = dueStep(state);
  const busy = state.work.state === "running" || (state.stop && state.stop.seconds === null);
  const to = due ? "commission" : "experiments";
  const next = at("next");
  next.hidden = busy || !at(to).hidden;
  next.href = `#${to}`;
  const number = described.steps.findIndex(({ name }) => name === due);
  next.textContent = due ? `Next: ${number + 1}. ${described.steps[number].title}` : "Next: an experiment";
  if (!due && !at("experiments").hidden) openForm();
}

function heed(told) {
  const link = at("link");
  if (told.type === "welcome") {
    bench.client = told.client;
    sessionStorage.setItem("client", told.client);
  } else if (told.type === "stop heard" || told.type === "stop unheard") {
    for (const tell of tellOfStop.splice(0)) tell(told.type === "stop heard");
  } else if (told.type === "no move") {
    letGo();
    complain(told.why);
  } else if (told.type === "lost") {
    letGo();
    link.className = "lost";
    link.textContent = "no answer from the server: what this page started is stopped";
  } else if (told.type === "state") {
    if (told.steps === null) told.steps = bench.state.steps; // as they were: they are told when they change
    if (told.work.state === "running" && bench.state && bench.state.work.state !== "running") at("errors").replaceChildren(); // of before
    bench.state = told;
    link.className = "";
    link.textContent = "connected";
    at("emulated").hidden = !told.emulated;
    document.title = `${told.emulated ? "EMULATED " : ""}${bench.described.machine.name} · Isocenter bench`;
    showNow(told);
    showLive(bench);
    showNext(bench);
    updateSteps(bench);
    scope.told(told);
    if (!at("state").hidden) showState(bench);
    if (!at("recordings").hidden && listing.of !== told.work.state + told.work.title) {
      listing.of = told.work.state + told.work.title;
      showFiles(bench);
    }
  }
}

at("stop").addEventListener("click", stop);
at("angles").value = angles();
at("angles").onchange = () => {
  localStorage.setItem("angles", at("angles").value);
  window.dispatchEvent(new Event("angles"));
  if (bench.state) {
    showLive(bench);
    showState(bench);
  }
};
window.addEventListener("keydown", (event) => {
  if (event.key === "Escape") {
    event.preventDefault();
    event.stopImmediatePropagation();
    stop();
  }
}, true);
window.addEventListener("hashchange", show);

const response = await fetch("/api/bench");
bench.described = await response.json();
const { machine } = bench.described;
at("machine").textContent = `${machine.name} on ${machine.bus}`;
at("machine").title = machine.description;
at("folder").textContent = bench.described.folder;
showSteps(bench, at("steps"));
showForms(bench, at("forms"));
buildLive(bench, (order) => worker.postMessage({ move: order }), complain);
show();

const scheme = location.protocol === "https:" ? "wss" : "ws";
worker.onmessage = (event) => heed(event.data);
worker.postMessage({ client: sessionStorage.getItem("client") || "", address: `${scheme}://${location.host}/control` });
scope.open(`${scheme}://${location.host}/rows`);

at("release").onclick = () => {
  const axis = prompt("The drive lets go of the axis. If the axis stands and is supported, so that it cannot fall, type its name:");
  if (axis) ask("/api/release", { axis: axis.trim() }, bench.client).catch((error) => complain(error.message));
};
at("invite").onclick = async () => {
  at("invitation").textContent = (await ask("/api/invite", {}, bench.client)).address;
};
at("demo-line").hidden = !bench.described.has_demo;
at("demo").onclick = () => ask("/api/demo", {}, bench.client).catch((error) => complain(error.message));
buildRecorded(bench, complain);
at("plot").onclick = () => lay(ticked("train")).catch((error) => complain(error.message));
at("keep").onclick = () => look("plot");
at("diagnose").onclick = () => look("diagnose");

async function look(what) {
  try {
    await ask("/api/look", { what, files: ticked("train"), held_out: ticked("held"), derive: derivedTexts().join(","), align: at("align").value }, bench.client);
  } catch (error) {
    complain(error.message);
  }
}
