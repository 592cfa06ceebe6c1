// Recordings laid over each other: chosen channels and what is derived from them, aligned, in panes by unit.
import { channelBoxes, look, lookOf, options, pane, shownAs, whenAngles } from "./panes.js";
import { ask, element } from "./parts.js";
import { drawable } from "./ring.js";

const at = (id) => document.getElementById(id);
const FIRST = /^(position|command)_/;
const HEIGHT = 240;
const SIGHT = 1e-5; // of the largest amplitude
const HOW = {
  difference: (of, less) => `${of} - ${less}`,
  derivative: (of) => `d(${of})`,
  spectrum: (of) => `spectrum(${of})`,
};
let files = [];
let units = new Map(); // of the recordings' channels
let derived = []; // texts
const chosen = new Set();
const placed = new Map(); // channel -> the pane onto which it was dragged
const read = new Map(); // channel or derived text -> its curves, or why there are none
let shifts_s = [];
let generation = 0; // of the recordings and their alignment: an answer that was asked for before is dropped
let plots = [];
let client = () => "";

export const derivedTexts = () => derived.filter((text) => chosen.has(text));

export function buildRecorded(bench, complain) {
  client = () => bench.client;
  at("recorded-channels").parentElement.open = window.innerWidth >= 900;
  const tried = (does) => () => does().catch((error) => complain(error.message));
  at("align").onchange = tried(async () => {
    begin();
    await show();
  });
  at("derive-how").onchange = at("derive-of").onchange = offer;
  at("derive-add").onclick = tried(async () => {
    const text = HOW[at("derive-how").value](at("derive-of").value, at("derive-less").value);
    if (!(await load([text]))) return;
    const curves = read.get(text);
    if (curves.every(({ error }) => error)) throw new Error(curves.map(whyNot).join("; ") || `${text}: no recording has the channels`);
    if (!derived.includes(text)) derived.push(text);
    chosen.add(text);
    await show();
  });
  whenAngles(tried(show));
  at("recorded-channels").addEventListener("change", tried(show)); // a box has chosen already
  new ResizeObserver(() => plots.forEach((plot) => plot.setSize({ width: widthNow(), height: HEIGHT }))).observe(at("recorded-panes"));
}

// Forget what has been read, and what is being read.
function begin() {
  read.clear();
  shifts_s = [];
  return (generation += 1);
}

// Lay recordings over each other, by their names in the folder.
export async function lay(names) {
  const mine = begin();
  files = names;
  const told = await ask("/api/curves", { files, channels: [], align: "" }, client());
  if (mine !== generation) return;
  units = new Map(told.channels);
  for (const text of chosen) if (!units.has(text) && !derived.includes(text)) chosen.delete(text);
  if (!chosen.size) for (const name of units.keys()) if (FIRST.test(name)) chosen.add(name);
  const kept = at("align").value;
  at("align").replaceChildren(element("option", { value: "" }, "their first rows"),
    ...[...units.keys()].map((name) => element("option", { value: name, selected: name === kept }, name)));
  at("derive-of").replaceChildren(...[...units.keys()].map((name) => element("option", {}, name)));
  at("recorded").hidden = false;
  offer();
  await show();
  at("recorded").scrollIntoView({ block: "nearest" });
}

// What can be subtracted: channels of the same unit.
function offer() {
  const of = at("derive-of").value;
  at("derive-less-line").hidden = at("derive-how").value !== "difference";
  const same = [...units].filter(([name, unit]) => name !== of && unit === units.get(of)).map(([name]) => name);
  at("derive-less").replaceChildren(...same.map((name) => element("option", {}, name)));
  at("derive-add").disabled = at("derive-how").value === "difference" && !same.length;
}

// Read curves; whether they are still asked for when they come.
async function load(texts) {
  const mine = generation;
  const told = await ask("/api/curves", { files, channels: texts, align: at("align").value }, client());
  if (mine !== generation) return false;
  for (const text of texts) read.set(text, []);
  for (const curve of told.curves) {
    read.get(curve.channel).push(curve.error ? curve : { ...curve, x: numbers(curve.x), y: numbers(curve.y), over: curve.x });
  }
  shifts_s = told.shifts_s;
  return true;
}

const whyNot = ({ of, error }) => (files.length > 1 ? `${files[of]}: ${error}` : error);

async function show() {
  const wanted = [...chosen].filter((text) => !read.has(text));
  if (wanted.length && !(await load(wanted))) return;
  const shifts = shifts_s.map((shift, index) => `${files[index]} ${(shift - shifts_s[0]).toFixed(3)} s`).slice(1);
  const aligned = at("align").value && shifts.length ? [`shifted against ${files[0]}: ${shifts.join(", ")}`] : [];
  const lacking = [...chosen].flatMap((text) => read.get(text) || []).filter(({ error }) => error);
  at("recorded-note").textContent = [...aligned, ...lacking.map(whyNot)].join("; ");
  const names = [...derived, ...units.keys()];
  const boxes = channelBoxes(names, (text) => (units.has(text) ? shownAs(units.get(text))[0] : "derived"), chosen, (text, is) => {
    placed.delete(text);
    if (is) chosen.add(text);
    else chosen.delete(text);
  });
  at("recorded-channels").replaceChildren(...boxes);
  draw();
}

function numbers(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float64Array(bytes.buffer);
}

const widthNow = () => Math.max(200, at("recorded-panes").clientWidth - 12);

function draw() {
  plots.forEach((plot) => plot.destroy());
  const panes = new Map(); // what a pane shows, by its unit and over what
  const members = new Map(); // the channels in it
  for (const text of chosen) {
    for (const curve of (read.get(text) || []).filter(({ error }) => !error)) {
      const [unit, scale] = shownAs(curve.unit);
      const key = placed.get(text) ?? (curve.kind === "spectrum" ? `spectrum ${unit}` : unit);
      if (!members.has(key)) members.set(key, []);
      if (!members.get(key).includes(text)) members.get(key).push(text);
      const index = members.get(key).indexOf(text);
      const style = files.length > 1 ? look(curve.of, index) : lookOf(index); // the recording by its colour, the channel by its dashes
      const label = files.length > 1 ? `${text} · ${files[curve.of]}` : text;
      const y = drawable(scale === 1 ? curve.y : curve.y.map((value) => scale * value));
      panes.set(key, [...(panes.get(key) || []), { ...curve, y: curve.kind === "spectrum" ? inSight(y) : y, unit, label, ...style }]);
    }
  }
  at("recorded-panes").replaceChildren();
  plots = [...panes].map(([key, series]) => {
    const isSpectrum = series[0].kind === "spectrum";
    const place = pane(key, series, (text) => drop(text, key, isSpectrum));
    at("recorded-panes").append(place);
    const how = options({
      unit: series[0].unit, series, width: widthNow(), height: HEIGHT, sync: isSpectrum ? "spectrum" : "recorded",
      xLabel: isSpectrum ? "frequency [Hz]" : "time [s]", y: isSpectrum ? { distr: 3 } : {},
    });
    const same = series.every(({ over }) => over === series[0].over);
    const data = same ? [series[0].x, ...series.map(({ y }) => y)] : uPlot.join(series.map(({ x, y }) => [x, y]));
    return new uPlot(how, data, place);
  });
}

// Of a spectrum what a logarithmic axis of some decades shows.
function inSight(amplitudes) {
  const least = SIGHT * amplitudes.reduce((most, value) => Math.max(most, value || 0), 0);
  return Array.from(amplitudes, (value) => (value >= least && value > 0 ? value : null));
}

// A channel that was dragged onto a pane is drawn there; one over time not onto a spectrum.
async function drop(text, key, isSpectrum) {
  if (!units.has(text) && !derived.includes(text)) return;
  if (isSpectrum !== text.startsWith("spectrum(")) return;
  placed.set(text, key);
  chosen.add(text);
  await show();
}
