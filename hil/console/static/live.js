// The live view: position, speed, effort, brake, mode and temperature of every axis, and buttons that move it for as long as they are held.
import { draw } from "./drawing.js";
import { shownAs, whenAngles } from "./panes.js";
import { ask, element, number } from "./parts.js";

const at = (id) => document.getElementById(id);
const RENEW_MS = 100;
const EDGE = { rad: 180 / Math.PI, m: 1000 };
const SPEEDS = [1, 5, 10]; // degrees (mm) a second
const DOING = {
  watching: "Connected. Nothing moves: drives disabled, brakes closed.",
  homing: "Homing: an axis is pushed a little, then finds its zero. It moves.",
  ready: "Homed. Hold a button to move an axis; let go, and it stops.",
  "opening brakes": "Opening the brakes ...",
  holding: "The drives hold. Without a move the brakes close in a few seconds.",
  "on the way": "On the way to the pose where it starts. It moves.",
  "coming to rest": "At the start: waiting until it stands.",
  recording: "Recording.",
  "closing brakes": "Closing the brakes ...",
  stopping: "Stopping the motors ...",
};
const JOGS = "An axis moves for as long as its button is held.";
const HANDED = "The drives are off, the brakes closed. What was started takes the machine.";
const COMPUTES = "Something is computed; the machine is not connected meanwhile.";
const cards = new Map();
let wasHomed = true; // as it was told last
let held = null; // { button, timer }
let tellMove = () => {};
let moveDrawing = () => {};

export function buildLive(bench, tell, complain) {
  at("live").hidden = !bench.described.has_live;
  if (at("live").hidden) return;
  tellMove = tell;
  for (const axis of bench.described.axes) {
    const value = (what) => element("b", { "data-what": what }, "–");
    const jog = (sign, mark, words) => {
      const button = element("button", { type: "button", class: "jog", "aria-label": `${axis.name} ${words}, while held` }, mark);
      holdable(button, () => `jog ${axis.name} ${sign * Number(at("jog-speed").value)}`);
      return button;
    };
    const place = element("b", { class: "place", "data-what": "position" }, "–");
    const buttons = [jog(-1, "−", "backward"), jog(1, "+", "forward")];
    const values = Object.fromEntries(["speed", "effort", "brake", "temperature"].map((what) => [what, value(what)]));
    const drive = element("div", { class: "dim drive", "data-what": "drive" }, "–");
    const bar = element("div", { class: "range" }, element("i", {}), element("u", { title: "where the way leads", hidden: true }));
    const card = element("div", { class: "axis", "data-axis": axis.name },
      element("div", { class: "head" }, element("span", {}, axis.name), place),
      element("div", { class: "hold" }, buttons[0], bar, buttons[1]),
      element("div", { class: "values" }, ...Object.entries(values).map(([what, cell]) => element("span", {}, `${what} `, cell))),
      drive);
    const brief = element("span", {}, "");
    at("emergency").before(brief);
    cards.set(axis.name, { axis, brief, place, buttons, values, drive, bar, card });
    at("live-axes").append(card);
  }
  const inside = ({ lower, upper, unit, name }) => ({ name, lower: lower / EDGE[unit], upper: upper / EDGE[unit] });
  const { pictures, move } = draw(bench.described.bodies, bench.described.axes.map(inside));
  at("live-drawing").append(...pictures.map(({ name, svg }) => element("figure", {}, svg, element("figcaption", { class: "dim" }, name))));
  moveDrawing = move;
  const first = bench.described.axes[0];
  at("jog-speed").append(...SPEEDS.map((speed) => element("option", { value: speed, selected: speed === 5 })));
  const nameSpeeds = () => [...at("jog-speed").options].forEach((option) => {
    const [unit, scale] = shownAs(first.unit);
    option.textContent = `${Number(((option.value / EDGE[first.unit]) * scale).toPrecision(3))} ${unit}/s`;
  });
  nameSpeeds();
  whenAngles(nameSpeeds);
  at("live-home").onclick = () => ask("/api/move", { order: "home" }, bench.client).catch((error) => complain(error.message));
  at("live-again").onclick = () => ask("/api/connect", {}, bench.client).catch((error) => complain(error.message));
  for (const gone of ["blur", "pagehide"]) window.addEventListener(gone, letGo);
  document.addEventListener("visibilitychange", () => document.hidden && letGo());
  window.addEventListener("keydown", (event) => event.key === "Escape" && letGo(), true);
}

// A button that orders again and again while it is held, by a finger, a mouse or a key; without its orders the machine stops by itself.
function holdable(button, order) {
  const begin = () => {
    if (button.disabled || held) return;
    tellMove(order());
    held = { button, timer: setInterval(() => tellMove(order()), RENEW_MS) };
    button.classList.add("held");
  };
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    if (button.hasPointerCapture(event.pointerId)) button.releasePointerCapture(event.pointerId); // a finger that slides off has left
    begin();
  });
  for (const ends of ["pointerup", "pointerleave", "pointercancel", "blur"]) button.addEventListener(ends, letGo);
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (!event.repeat) begin();
  });
  button.addEventListener("keyup", letGo);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

export function letGo() {
  if (!held) return;
  clearInterval(held.timer);
  held.button.classList.remove("held");
  held = null;
  tellMove("still");
}

// What a machine that tells does, in words, with what remains of it; what runs there may be work, or the live view.
export function doingOf(told, isWork = false) {
  if (told.says) return told.says;
  if (isWork && told.doing === "watching") return "The nodes are being started.";
  const left = told.remains_s === null || told.remains_s === undefined || told.doing === "recording" ? "" : ` ${Math.ceil(told.remains_s)} s to go`;
  const most = told.doing === "coming to rest" ? left.replace(" s to go", " s at most") : left;
  const ways = told.doing !== "on the way" ? [] : Object.entries(told.axes).map(([name, seen]) => wayOf(name, seen)).filter(Boolean);
  if (ways.length) return `${DOING[told.doing]} ${ways.join(", ")}${left && ";"}${left}`;
  if (told.doing === "holding" && Object.entries(told.axes).some(([name, seen]) => isSeenToMove(name, seen))) return JOGS;
  const which = told.doing === "homing" && told.part ? DOING.homing.replace("Homing", `Homing ${told.part}`) : DOING[told.doing];
  return which + most;
}

// Whether a drive says itself that it is off, and no brake is open. A machine that stops tells of drives that have voltage as well.
const isOff = ({ drive, brake }) => Boolean(drive) && drive.startsWith("switch on disabled") && brake !== "open";

// A position or a speed in the unit in which the page shows it; radians with two digits more.
function inUnit(value, of, digits, after = "") {
  const [unit, scale] = shownAs(of);
  const text = (value * scale).toFixed(digits + (unit === "rad" ? 2 : 0)).replace(/^-(0\.0+)$/, "$1");
  return `${text}${unit === "deg" && !after ? "°" : ` ${unit}${after}`}`;
}

// Whether the speed that the page shows of an axis is other than zero.
const isSeenToMove = (name, { speed }) => speed !== null && cards.has(name) && Math.abs(speed) * EDGE[cards.get(name).axis.unit] >= 0.05;

// How far an axis has yet to go, in its unit; "" where it is there already.
function wayOf(name, { position, goes_to: end }) {
  if (end === null || end === undefined || position === null || !cards.has(name)) return "";
  const { unit } = cards.get(name).axis;
  const far = Math.abs(end - position);
  return far * EDGE[unit] < 0.05 ? "" : `${name} ${inUnit(far, unit, 1)} from it`;
}

export function showLive(bench) {
  const { live, recording, stop, work, wire } = bench.state;
  showEmergency(wire, live.told || work.told);
  if (at("live").hidden) return;
  const told = live.told || (work.told && work.told.doing !== "recording" ? work.told : null); // rows tell more of a recording
  const busy = work.state === "running";
  const handed = busy && live.told && told.doing === "stopping" && !live.holds && !stop && Object.values(told.axes).every(isOff);
  at("live-doing").textContent = told ? (handed ? HANDED : doingOf(told, !live.told))
    : busy ? (recording && recording.live && recording.began ? DOING.recording : work.moves ? "What runs now begins ..." : COMPUTES)
      : live.trouble || (live.running ? `Connecting: ${live.progress || "the nodes are looked for"} ...` : "Connecting ...");
  at("live-doing").className = live.trouble ? "bad" : live.moves || (busy && work.moves) ? "moves" : "";
  at("live-again").hidden = !live.trouble;
  at("live-home").disabled = !live.told || told.doing !== "watching";
  at("live-home").hidden = Boolean(told) && told.doing !== "watching";
  const jogs = Boolean(live.told) && ["ready", "opening brakes", "holding"].includes(told.doing);
  if (!jogs) letGo();
  const positions = {};
  const isOld = !told && !(recording && recording.live); // nobody looks at the machine just now
  if (told) wasHomed = told.homed;
  else if (recording && recording.live) wasHomed = true;
  for (const [name, { axis, brief, place, buttons, values, drive, bar, card }] of cards) {
    const seen = told ? told.axes[name] : fromRow(bench, name, isOld);
    const scale = EDGE[axis.unit];
    const known = (value) => value !== undefined && value !== null && !Number.isNaN(value);
    const position = known(seen.position) ? seen.position * scale : null;
    if (position !== null) positions[name] = seen.position;
    place.textContent = position === null ? "–" : inUnit(seen.position, axis.unit, 2);
    values.speed.textContent = known(seen.speed) ? inUnit(seen.speed, axis.unit, 1, "/s") : "–";
    values.effort.textContent = known(seen.effort) ? `${seen.effort.toFixed(2)} ${axis.effort_unit}` : "–";
    values.brake.textContent = known(seen.brake) ? seen.brake : "–";
    values.temperature.textContent = known(seen.temperature_degC) ? `${number(seen.temperature_degC, 3)} °C` : "–";
    drive.textContent = [seen.mode, seen.drive].filter(Boolean).join(": ") || "–";
    if (position !== null && !wasHomed) place.textContent += " not homed";
    brief.textContent = `${name} ${place.textContent} · ${isOld ? "seen last" : values.effort.textContent}`;
    const end = told && seen.goes_to !== null && seen.goes_to !== undefined ? seen.goes_to * scale : null;
    bar.lastChild.hidden = end === null;
    if (end !== null) bar.lastChild.style.left = `${Math.max(0, Math.min(100, (100 * (end - axis.lower)) / (axis.upper - axis.lower)))}%`;
    const share = position === null ? 50 : (100 * (position - axis.lower)) / (axis.upper - axis.lower);
    bar.firstChild.style.left = `${Math.max(0, Math.min(100, share))}%`;
    bar.title = [axis.lower, axis.upper].map((end) => inUnit(end / scale, axis.unit, 0)).join(" to ");
    for (const button of buttons) button.disabled = !jogs;
    card.classList.toggle("old", isOld);
  }
  moveDrawing(positions);
}

// Beside position and effort, in every view: what a drive has sent as an emergency, or says of itself.
function showEmergency({ nodes, trouble }, told) {
  const sent = nodes.filter((node) => node.emergency).map((node) => `${node.name}: ${node.emergency}`);
  const faults = Object.entries(told ? told.axes : {}).filter(([, { drive }]) => drive && drive.includes("fault")).map(([name, { drive }]) => `${name}: ${drive}`);
  const found = [...sent, ...faults];
  const none = trouble ? "emergencies are told by what runs" : "no emergency";
  at("emergency").textContent = found.length ? `EMERGENCY ${found.join("; ")}` : none;
  at("emergency").className = found.length ? "bad" : "dim";
}

// What rows tell of an axis, and while they come what does not change in a recording: mode and brake, as its beginning was told.
function fromRow({ state, speedOf }, name, isOld) {
  const { newest, wire, work, io } = state;
  const seen = { position: newest[`position_${name}`], effort: newest[`current_${name}`] ?? newest[`effort_${name}`], temperature_degC: newest[`temperature_${name}`] };
  if (isOld) return seen;
  const { mode, brake } = work.told ? work.told.axes[name] : { brake: io ? (io.brakes_open[name] ? "open" : "closed") : null };
  const drive = wire.nodes.find((node) => node.axis === name && node.role === "drive");
  return { ...seen, speed: speedOf(name), mode, brake, drive: drive && drive.state };
}
